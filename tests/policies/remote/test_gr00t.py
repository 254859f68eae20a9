"""Policy servers of GR00T: one written from the contract, in a thread, and what it answers when it is faulty."""

import pickle
import socket
import sys
import time

import msgpack
import numpy as np
import pytest

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, PolicyNotInstalled, PolicyUnreachable
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.errors import one_line_error
from tests.policies.remote.test_client import query
from tests.remote_servers import speaking

servers = pytest.importorskip("tests.policies.remote.gr00t_server")
LIBERO, serving, chunk = servers.LIBERO, servers.serving, servers.chunk

QUICK = {"timeout_s": 5.0, "connect_timeout_s": 2.0, "retries": 0}
STATE = {"x": [0], "y": [1], "z": [2], "roll": [3], "pitch": [4], "yaw": [5], "gripper": [6, 7]}
OURS = {"convention": "robogauntlet", "proprioception": STATE}
UNITS = {"translation_scale": 0.1, "rotation": "euler", "rotation_scale": 1.0, "gripper_open": 1, "gripper_closed": 0}


def remote(address, **options):
    return catalog.load("gr00t", {"address": address, **QUICK, **options})


@pytest.mark.parametrize("writes", [servers.N16, servers.N17])
def test_an_observation_is_sent_as_the_contract_says_and_a_chunk_is_read(writes):
    seen, asked = [], query()
    with serving(writes=writes, seen=seen) as address:
        policy = remote(address, **UNITS, proprioception=STATE, execute=8)
        (decision,) = policy.act([asked])
        policy.close()
    assert [message["endpoint"] for message in seen] == ["ping", "get_modality_config", "reset", "get_action"]
    assert seen[2]["data"] == {"options": None}
    observation = seen[3]["data"]["observation"]
    for camera, key in (("third_person", "image"), ("wrist", "wrist_image")):
        np.testing.assert_array_equal(observation["video"][key], asked.observation.images[camera][None, None])
    sent = np.concatenate([observation["state"][key] for key in STATE], axis=2)
    np.testing.assert_array_equal(sent, np.float32(asked.observation.proprioception)[None, None])
    assert sent.dtype == np.float32
    assert observation["language"] == {LIBERO["language"]["modality_keys"][0]: [[asked.observation.instruction]]}
    assert decision.actions.shape == (8, 7)
    np.testing.assert_allclose(decision.actions[:, 1], 0.1 * np.arange(8))
    assert (decision.actions[:, 6] == -1.0).all()  # 1 is open


def test_an_episode_is_played_and_again_with_the_same_row_and_begins_with_a_reset():
    seen, episode = [], Episode("gr00t", "digest", "null/Reach", 0, Protocol(12, 8, View(image_size=32)))
    with serving(seen=seen) as address:
        policy, simulation = remote(address, **OURS), open_simulation("null/Reach", View(image_size=32))
        first, again = (rollout(simulation, policy, episode) for _ in range(2))
        policy.close()
    assert (first.steps, first.actions_hash) == (12, again.actions_hash)
    assert [message["endpoint"] for message in seen[2:]] == ["reset", "get_action", "get_action"] * 2


def test_liberos_convention_says_the_keys_of_the_state_and_joints_may_have_keys_of_their_own():
    with serving() as address:
        task = query(task="libero/spatial-pick_up_the_black_bowl")
        assert list(remote(address, convention="libero").images_sent(task)) == ["image", "wrist_image"]
    arm = LIBERO | {name: {"delta_indices": [0], "modality_keys": ["arm", "hand"]} for name in ("state", "action")}
    answer = {"hand": np.ones((1, 4, 1), np.float32), "arm": np.full((1, 4, 6), 2.0, np.float32)}
    seen, options = [], {"joints": 6, "gripper_open": 0.0, "gripper_closed": 1.0}
    with serving(lambda _: answer, arm, seen=seen) as address:
        keys = {"arm": [0, 1, 2, 3, 4, 5], "hand": [6]}
        policy = remote(address, **options, proprioception=keys)
        (decision,) = policy.act([query(joints=6)])
        policy.close()
    np.testing.assert_allclose(decision.actions, [[2.0] * 6 + [1.0]] * 4)
    assert {key: part.shape for key, part in seen[-1]["data"]["observation"]["state"].items()} == {
        "arm": (1, 1, 6),
        "hand": (1, 1, 1),
    }


def test_a_token_is_sent_with_each_question(monkeypatch):
    monkeypatch.setenv("ROBOGAUNTLET_POLICY_TOKEN", "sesame")
    with serving(token="sesame") as address:
        policy = remote(address, **OURS, token_variable="ROBOGAUNTLET_POLICY_TOKEN")
        assert len(policy.act([query()])) == 1
        with one_line_error(PolicyError, "got an error: Unauthorized: .*; give its token by option token_variable"):
            remote(address, **OURS)
    with one_line_error(PolicyError, "token_variable: a token is sent to this machine only, got gr00t://far:1"):
        remote("gr00t://far:1", **OURS, token_variable="ROBOGAUNTLET_POLICY_TOKEN")


def test_a_check_plays_it(run_command, tmp_path):
    with serving() as address:
        given = [f"--option={name}={value}" for name, value in (OURS | {"execute": 8}).items()]
        picture = ("--picture", str(tmp_path / "check.png"))
        done = run_command("check", "policy", address, *given, "--task", "null/Reach", *picture)
    assert "chunks of 16 actions" in done.out or "chunks of 8 actions" in done.out, done.err
    assert "the same episode after another one: the same actions" in done.out


def modalities(**changed):
    return {"modalities": LIBERO | {name: LIBERO[name] | change for name, change in changed.items()}}


def keys(*names):
    return {"modality_keys": list(names)}


def wrong(name="x", value=None):
    return {"answer": lambda observation: chunk(observation) | {name: value}}


def npy(header, numbers=b""):
    text = header.encode().ljust(117) + b"\n"
    return {
        "__ndarray_class__": True,
        "as_npy": b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + numbers,
    }


N15 = {name: keys(f"{name}.{LIBERO[name]['modality_keys'][0]}") for name in LIBERO}
POSE = {"action_configs": [{"rep": "RELATIVE", "type": "EEF", "format": "XYZ_ROT6D"}] * 7}
BILLION = npy("{'descr': '<f4', 'fortran_order': False, 'shape': (1, 1000000000, 7), }")
OBJECTS = npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", pickle.dumps([print]))
NAN = np.full((1, 16, 1), np.nan, np.float32)
BAD = {
    "pickles": ({"ping": b"ERROR"}, {}, "got what servers of N1.5 send, which speak pickles: .* never read"),
    "a pickle": ({"get_modality_config": pickle.dumps({})}, {}, "servers of N1.5 send, which speak pickles"),
    "torch": ({"get_action": b"PK\x03\x04archive"}, {}, "servers of N1.5 send, which speak pickles"),
    "N1.5 keys": (modalities(**N15), {}, "expected keys as of GR00T N1.6, got video.image, as of N1.5"),
    "units": ({}, {"convention": None}, "modalities do not say translation_scale, .* or all by option convention"),
    "images": (
        modalities(video=keys("ego_view")),
        {},
        "its video is ego_view, got nothing: nothing fills ego_view; give option cameras: {third_person: KEY}",
    ),
    "a camera": ({}, {"cameras": {"wrist": "hand"}}, "nothing fills image, wrist_image; give option cameras"),
    "state": (
        modalities(state=keys("x", "pad")),
        {},
        "nothing fills pad; give option proprioception: {KEY: .columns.}",
    ),
    "no state": ({}, {"proprioception": None}, "its state is x, y, .*, got nothing: nothing fills x, y, z, roll"),
    "more state": ({}, {"proprioception": STATE | {"w": [0]}}, "got x, .*, w: it has no such key; give option prop"),
    "words": (modalities(language=keys("a", "b")), {}, "its language is a, b, .* give option instruction"),
    "actions": ({}, {"actions": ["x", "dx"]}, "its action is x, .* got .*: it has no such key; give option actions"),
    "frames": (
        modalities(video={"delta_indices": [-1, 0]}),
        {},
        "expected video of the present step alone, .* got -1, 0",
    ),
    "poses": (modalities(action=POSE), {}, "expected displacements of the tool or .*, its action x is a pose"),
    "no modalities": ({"get_modality_config": {}}, {}, "expected modalities video, .*, got none: no video"),
    "a list": ({"get_modality_config": [1]}, {}, "expected modalities video, .*, got none: no video"),
    "no keys": (modalities(video={"modality_keys": 5}), {}, "modality_keys and delta_indices: video.modality_keys: "),
    "no JSON": (
        {"get_modality_config": {"video": {"__ModalityConfig_class__": True, "as_json": "[" * 9}}},
        {},
        "expected a modality's configuration as JSON, got text that is none",
    ),
    "much": (
        {"get_modality_config": b"\xda\xff\xff" * 10 + b"a" * 2**21},
        {},
        "modalities of at most 1 MiB, got 2097182 by",
    ),
    "one action": (
        wrong(value=np.zeros((1, 1), np.float32)),
        {},
        r"a chunk of shape \(1, n, columns\) as 'x', got \(1, 1\)",
    ),
    "a batch": (wrong(value=np.zeros((2, 16, 1), np.float32)), {}, r"a chunk of shape .* as 'x', got \(2, 16, 1\)"),
    "lengths": (wrong(value=np.zeros((1, 8, 1), np.float32)), {}, r"with one n, got x \(8, 1\), y \(16, 1\)"),
    "short": ({}, {"execute": 20}, "option execute: expected 20 actions or more, got 16"),
    "wide": (wrong(value=np.zeros((1, 16, 2), np.float32)), {}, r"shape \(n, 7\).*, got \(16, 8\); .* option columns"),
    "NaN": (wrong(value=NAN), {}, "expected finite numbers as 'x, y, z, .*', got nan in row 0, column 0"),
    "a word": (wrong(value="left"), {}, "expected numbers as 'x', got str"),
    "no key": ({"answer": lambda _: {"y": NAN}}, {}, "expected 'x' in the answer, got y; set option actions"),
    "no list": ({"get_action": {"x": 1}}, {}, "expected a list of actions and information, got dict"),
    "objects": (
        wrong(value=OBJECTS),
        {},
        "expected an array of numbers as an .npy file of version 1, got something else",
    ),
    "a billion": (wrong(value=BILLION), {}, r"an array of type float32 and shape \(1, 1000000000, 7\), got 0 bytes"),
    "msgpack": ({"get_action": b"\xc1"}, {}, "expected msgpack, got 1 bytes that are not"),
    "an object": (
        {"get_action": msgpack.packb([{"x": {b"nd": True, b"kind": b"O", b"data": b""}}, {}])},
        {},
        "expected an array of numbers, got one of objects or structures",
    ),
    "values": ({"get_action": [0] * 100_001}, {}, "expected a message of 100000 values at most"),
    "too large": ({"get_action": b"\0" * (17 * 2**20)}, {}, "or began an answer of more than 16 MiB; start the server"),
    "an error": (
        {"get_action": {"error": "Traceback\nVideo key 'image' must be"}},
        {},
        "got an error: Video key 'image' must",
    ),
    "a wrapper": (
        {"get_action": {"error": "Video key 'video.image' must be in observation"}},
        {},
        "must be in observation; start it without --use-sim-policy-wrapper",
    ),
    "dies": (
        {"get_action": None},
        {},
        "expected an answer within 1 attempts and 5 s, got none: it closed the connection",
    ),
    "late": ({"get_action": lambda: time.sleep(0.3)}, {"timeout_s": 0.2}, r"within 0\.2 s, got none; raise timeout_s"),
    "no pong": (
        {"ping": lambda: time.sleep(0.3)},
        {"connect_timeout_s": 0.2},
        "got nothing in time; is it another kind",
    ),
}


@pytest.mark.parametrize(("server", "options", "match"), BAD.values(), ids=BAD)
def test_a_faulty_server_or_one_that_cannot_be_asked_is_one_line(server, options, match):
    given = {name: value for name, value in (OURS | options).items() if name != "convention" or value}
    with serving(**server) as address, one_line_error(PolicyError, match) as caught:
        remote(address, **given).act([query()])
    assert str(caught.value).startswith(f"policy server {address}: ")
    assert len(str(caught.value)) < 600


def test_another_kind_of_server_and_none_are_one_line():
    with speaking(lambda connection: None) as address, one_line_error(PolicyError, "got no greeting of ZeroMQ; is it "):
        remote(address.replace("ws", "gr00t"), **OURS, connect_timeout_s=0.3)
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        port = nobody.getsockname()[1]
    with one_line_error(PolicyUnreachable, "no connection: .*label .*too long"):
        remote(f"gr00t://{'a' * 70}.example:1", **OURS)
    with one_line_error(PolicyUnreachable, "no connection: connection refused; start the server"):
        remote(f"gr00t://127.0.0.1:{port}", **OURS)


def test_a_lost_connection_is_opened_again_and_a_late_answer_is_never_the_next_ones():
    late = [lambda: time.sleep(0.3) or {}, lambda: [chunk(NOTHING, 3), {}]]
    with serving(get_action=lambda: late.pop(0)() if len(late) > 1 else late[0]()) as address:
        policy = remote(address, **OURS, timeout_s=0.2)
        with pytest.raises(PolicyError, match="expected an answer within"):
            policy.act([query()])
        time.sleep(0.2)
        (decision,) = policy.act([query(step=1)])
        assert len(decision.actions) == 3
        policy.close()


NOTHING = {"video": {"image": np.zeros((1, 1, 1, 1, 3))}, "state": {}}


def test_a_server_is_known_by_its_address_and_modalities_or_its_identity():
    with serving() as first, serving() as second:
        assert len({catalog.digest("gr00t", {"address": address, **OURS}) for address in (first, second)}) == 2
        kind, named = catalog.find("gr00t"), {"address": first, "identity": "gr00t@1", **OURS}
        assert "its server names no checkpoint" in kind.contact({"address": first, **OURS}).warning
        contact = kind.contact(named)
    with serving(**modalities(action={"delta_indices": [0]})) as other:
        policy = catalog.load("gr00t", {**contact.options, "address": other})
        with one_line_error(PolicyError, "its metadata have changed under identity 'gr00t@1'"):
            policy.act([query()])


def test_without_pyzmq_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "zmq", None)
    with one_line_error(PolicyNotInstalled, r"no module zmq\); install it: pip install 'robogauntlet\[gr00t\]'"):
        remote("gr00t://127.0.0.1:1", **OURS)
