"""Model servers of vla-evaluation-harness: its own software in a process, and servers that are faulty."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.adapters.contract import Observation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, PolicyInput, PolicyMismatch, PolicyUnreachable, Query
from robogauntlet.policies.remote.msgpack_numpy import pack, unpack
from robogauntlet.policies.remote.remote_policy import ConnectionLost
from robogauntlet.policies.remote.server_options import read_options
from robogauntlet.policies.remote.vla_eval import VlaEvalOptions
from robogauntlet.policies.remote.vla_eval_specs import fitted
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.errors import one_line_error
from tests.remote_servers import answering, speaking

QUICK = {"timeout_s": 5.0, "connect_timeout_s": 2.0, "retries": 1}
OURS = {"convention": "robogauntlet"}
SCALES = {"translation_scale": 0.1, "rotation_scale": 0.5}
LIBEROS = {
    "position": {"name": "position", "dims": 3, "format": "delta_xyz", "range": [-1, 1]},
    "rotation": {"name": "rotation", "dims": 3, "format": "axis_angle", "range": [-3.15, 3.15]},
    "gripper": {"name": "gripper", "dims": 1, "format": "binary_close_positive", "range": [-1, 1]},
}
IMAGE = {"name": "image", "dims": 0, "format": "rgb_hwc_uint8"}


@pytest.fixture(scope="module")
def theirs():
    """Name of a server of `vla_eval_servers.py` to its address."""
    pytest.importorskip("vla_eval.model_servers.serve")
    command = [sys.executable, str(Path(__file__).with_name("vla_eval_servers.py"))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            yield {name: f"vla-eval://127.0.0.1:{port}" for name, port in json.loads(process.stdout.readline()).items()}
        finally:
            process.kill()


def query(step=0, seed=0, instruction="reach the goal"):
    episode = Episode("pi0", "digest", "null/Reach", seed, Protocol(60, 8, View(image_size=32)))
    generator = np.random.default_rng([seed, step])
    images = {name: generator.integers(0, 256, (32, 32, 3), dtype=np.uint8) for name in ("third_person", "wrist")}
    return Query(episode, step, Observation(images, np.arange(8.0), instruction))


def pixel(asked, camera="third_person", place=(0, 0, 0)):
    return asked.observation.images[camera][place] / 255


def remote(address, **options):
    return catalog.load("vla-eval", {"address": address, **QUICK, **options})


def acted(policy, asked):
    (decision,) = policy.act([asked])
    assert decision.actions.shape == (1, 7)
    return decision.actions[0]


def test_each_step_is_a_query_and_the_server_keeps_the_chunk(theirs):
    policy = remote(theirs["chunks"], **SCALES)
    assert (policy.spec.sees, policy.spec.chunk_length) == (PolicyInput.OBSERVATION, 1)
    assert catalog.wishes("vla-eval", {"address": theirs["chunks"]}).execute == 1
    found = [acted(policy, query(step)) for step in range(5)]
    first, fourth = pixel(query(0)), pixel(query(4))
    expected = [[first, 0.0, 0.0], [first, 0.1, 0.0], [first, 0.2, 0.0], [first, 0.3, 0.0], [fourth, 0.0, 0.04]]
    np.testing.assert_allclose([action[:3] for action in found], 0.1 * np.array(expected), atol=1e-7)
    policy.close()


def test_episodes_at_once_have_a_session_each_and_a_new_one_gets_no_chunk_of_an_old_one(theirs):
    policy = remote(theirs["chunks"], **OURS)
    for step in range(3):
        decisions = policy.act([query(step, seed) for seed in (1, 2)])
        for seed, decision in zip((1, 2), decisions, strict=True):
            np.testing.assert_allclose(decision.actions[0, :2], [pixel(query(0, seed)), step / 10], atol=1e-7)
    policy.finish([query(0, 1).episode])
    policy.reset([query(0, 2).episode])
    for seed in (3, 2):
        np.testing.assert_allclose(acted(policy, query(0, seed))[:2], [pixel(query(0, seed)), 0.0], atol=1e-7)
    policy.close()


def test_an_episode_is_played_and_again_with_the_same_row(theirs):
    episode = Episode("pi0", "digest", "null/Reach", 0, Protocol(12, 8, View(image_size=32)))
    policy, simulation = remote(theirs["chunks"], **SCALES), open_simulation("null/Reach", View(image_size=32))
    first, again = (rollout(simulation, policy, episode) for _ in range(2))
    assert first.steps == 12
    assert first.actions_hash == again.actions_hash
    policy.close()


def test_the_observation_has_the_keys_of_their_benchmarks(theirs):
    policy, asked = remote(theirs["shown"], **OURS), query()
    pixels = [pixel(asked, camera, (0, 1, 2)) for camera in ("third_person", "wrist")]
    np.testing.assert_allclose(acted(policy, asked), [*pixels, 0.14, 0.28, 1.0, 0.0, 1.0], atol=1e-7)
    assert list(policy.images_sent(asked)) == ["agentview", "wrist"]
    policy.close()


def test_an_image_and_a_state_that_the_server_does_not_ask_for_are_not_sent(theirs):
    assert list(remote(theirs["chunks"], **SCALES).images_sent(query())) == ["agentview"]
    assert fitted(options(**SCALES), {"action_spec": LIBEROS}).proprioception is None


def test_the_gripper_is_turned_as_the_servers_spec_says(theirs):
    assert acted(remote(theirs["turned"], **SCALES), query())[6] == -1.0


@pytest.mark.parametrize(
    ("server", "instruction", "match"),
    [
        ("raising", "reach", r"expected an answer, got an error: observation_failed: KeyError: 'joints'$"),
        ("raising", "refuse", r"got an error: at all$"),
        ("whole chunks", "reach", "expected one action as 'actions', got 4; .* give it chunk_size"),
        ("unsaid", "reach", "does not say translation_scale, rotation, rotation_scale, gripper_open, gripper_closed; "),
    ],
)
def test_what_their_server_refuses_or_does_not_say_is_one_line(theirs, server, instruction, match):
    with one_line_error(PolicyError, match) as caught:
        policy = remote(theirs[server], **({} if server == "unsaid" else OURS))
        for step in range(2):
            policy.act([query(step, instruction=instruction)])
    assert str(caught.value).startswith("policy server ws://127.0.0.1:")


def test_a_check_and_openpis_client_at_its_port(theirs, run_command, tmp_path):
    place = ("--task", "null/Reach", "--picture", str(tmp_path / "check.png"))
    given = [text for name, value in SCALES.items() for text in ("--option", f"{name}={value}")]
    done = run_command("check", "policy", theirs["chunks"], *given, *place)
    assert "chunks of 1 actions, all executed" in done.out, done.err
    assert "the same episode after another one: the same actions" in done.out
    with one_line_error(PolicyError, "is it another kind of server"):
        address = theirs["chunks"].replace("vla-eval", "openpi")
        catalog.load("openpi", {"address": address, "connect_timeout_s": 0.5, "retries": 0})


def options(**given):
    return read_options({"address": "a:1", **given}, VlaEvalOptions)


RAW = {"actions": {"dims": 0, "format": "raw"}}
QUATERNIONS = LIBEROS | {"rotation": {"dims": 4, "format": "quaternion_xyzw"}}
SAID = {
    "axis-angle": (SCALES, LIBEROS, {"rotation": "axis-angle", "gripper_open": -1.0, "gripper_threshold": 0.0}),
    "euler": (SCALES, LIBEROS | {"rotation": {"dims": 3, "format": "euler_xyz"}}, {"rotation": "euler"}),
    "quaternion": ({"translation_scale": 1.0}, QUATERNIONS, {"rotation": "quaternion-xyzw", "width": 8}),
    "0 and 1": (
        SCALES,
        LIBEROS | {"gripper": {"dims": 1, "format": "binary_close_01"}},
        {"gripper_open": 0.0, "gripper_closed": 1.0, "gripper_threshold": 0.5},
    ),
    "the user's own": (
        SCALES | {"rotation": "euler", "gripper_open": 0.0, "gripper_closed": 1.0},
        LIBEROS,
        {"rotation": "euler", "gripper_open": 0.0, "gripper_threshold": None},
    ),
    "libero": (
        {"convention": "libero"},
        RAW,
        {"translation_scale": 0.0131, "gripper_open": -1.0, "turn": "left-right"},
    ),
    "a gripper alone": (SCALES | {"rotation": "euler"}, {"gripper": LIBEROS["gripper"]}, {"gripper_threshold": 0.0}),
    "joints": (
        {"joints": 6, "gripper_open": 0.0, "gripper_closed": 1.0},
        {"joints": {"dims": 6, "format": "joint_pos_abs"}, "gripper": {"dims": 1, "format": "continuous_01"}},
        {"joints": 6, "width": 7},
    ),
}


@pytest.mark.parametrize(("given", "spec", "expected"), SAID.values(), ids=SAID)
def test_options_that_are_not_given_are_those_of_the_specs(given, spec, expected):
    found = fitted(options(**given), {"action_spec": spec})
    assert {name: getattr(found, name) for name in expected} == expected


def model(*answers, hello=None, seen=None, **said):
    """A handler in the manner of a model server, with these payloads as answers; the last for ever."""
    hello = hello or {"type": "hello", "payload": {"protocol_version": 1, "action_spec": LIBEROS} | said, "seq": 0}
    left = list(answers)

    def handle(connection):
        for frame in connection:
            message = unpack(frame)
            if seen is not None:
                seen.append(message)
            if message["type"] == "hello":
                connection.send(pack(hello))
            elif message["type"] == "observation":
                answer = left.pop(0) if len(left) > 1 else left[0]
                answer = answer(connection, message) if callable(answer) else answer
                if answer is not None:
                    payload = {key: value for key, value in answer.items() if key != "message"}
                    said = {"type": "action", "payload": payload, "seq": message["seq"]}
                    connection.send(pack(said | answer.get("message", {})))

    return handle


def array(*numbers):
    data = np.float32(numbers)
    return {"__ndarray__": True, "dtype": data.dtype.str, "shape": list(data.shape), "data": data.tobytes()}


def said(**spec):
    return model({}, action_spec=LIBEROS | spec)


def seen(**spec):
    return model({}, observation_spec=spec)


ZEROS = {"actions": [0.0] * 7}
BAD = {
    "openpi's": (answering({}), "got a message of another protocol with model; .* begins with openpi://"),
    "newer": (model({}, protocol_version=2), "expected a server of protocol version 1, got version 2"),
    "no version": (model({}, protocol_version=None), "protocol version 1, got version None"),
    "hello?": (
        model({}, hello={"type": "action", "payload": {}}),
        "expected a message 'hello' .* got 'action' with dict",
    ),
    "hello!": (model({}, hello={"type": "error", "payload": {"error": "full\nup"}}), "got an error: up"),
    "specs": (model({}, action_spec=[1]), "expected action_spec of parts with dims and format: "),
    "a spec": (said(gripper={"dims": 1}), "action_spec of parts with dims and format: gripper.format: Field required"),
    "rotation": (said(rotation={"dims": 6, "format": "rot6d"}), "expected rotation as .* got rot6d of 6 numbers"),
    "dims": (said(position={"dims": 2, "format": "delta_xyz"}), "position as delta_xyz of 3 .* got delta_xyz of 2"),
    "absolute": (said(position={"dims": 3, "format": "absolute_xyz"}), "absolute_xyz .* which cannot be converted"),
    "base": (said(base={"dims": 4, "format": "x"}), "got position, rotation, gripper, base; give option columns"),
    "joints": (
        model({}, action_spec={"joints": {"dims": 7, "format": "joint_positions"}}),
        "got joints; give option joi",
    ),
    "scales": (model({}), "does not say translation_scale, rotation_scale; give each by an option, or all by option"),
    "gripper": (said(gripper={"dims": 1, "format": "continuous_01"}), "does not say .* gripper_open, gripper_closed"),
    "asks": (model({}, observation_params={"absolute_action": True}), "expected displacements, .* absolute_action"),
    "quaternion": (seen(state={"dims": 8, "format": "eef_pos3_quat4_gripper1"}), "cannot be converted; .*: null to"),
    "a state": (seen(state={"dims": 0, "format": "raw"}), "does not say what its state is; give option proprioception"),
    "depth": (seen(depth={"dims": 0, "format": "depth"}), "needs depth: depth of 0 numbers, which no task shows"),
    "images": (seen(a=IMAGE, b=IMAGE, c=IMAGE), "needs 3 images; name those that are sent by option cameras"),
    "no action": (model({"video": 1}), "expected 'actions' in the answer, got video; set option actions"),
    "a word": (model({"actions": "left"}), "expected numbers as 'actions', got list"),
    "no array": (model({"actions": {"__ndarray__": True, "dtype": "O", "shape": [1]}}), "expected an array of numbers"),
    "short data": (model({"actions": array() | {"shape": [10**9, 7]}}), "expected an array of type float32 and shape"),
    "wide": (model({"actions": array(*range(8))}), r"expected 'actions' of shape \(n, 7\).* option columns"),
    "chunk": (model({"actions": [[0.0] * 7] * 2}), "expected one action as 'actions', got 2; let the server keep"),
    "NaN": (model({"actions": array(*[0.0] * 6, np.nan)}), "expected finite numbers as 'actions', got nan"),
    "another's": (model(ZEROS | {"message": {"seq": 99}}), "expected the answer to the query, got another"),
    "no answer": (
        model(ZEROS | {"message": {"type": "hello"}}),
        "expected a message 'action' .* got 'hello' with dict",
    ),
    "error": (model({"error": "x\nout of memory", "message": {"type": "error"}}), "got an error: out of memory$"),
    "values": (model({"actions": [0] * 100_001}), "expected a message of 100000 values at most"),
    "closes": (model(lambda connection, _: connection.close()), "within 2 attempts .* it closed the connection"),
    "hangs": (model(lambda *_: time.sleep(1.0)), r"expected an answer within 0\.3 s, got none; raise timeout_s"),
    "no hello": (lambda connection: time.sleep(1.2), "got nothing in time; is it another kind of server"),
}
UNSAID = ("scales", "gripper", "a state", "quaternion")


@pytest.mark.parametrize("case", BAD)
def test_a_faulty_server_is_one_line(case):
    handler, match = BAD[case]
    limits = {"timeout_s": 0.3} if case == "hangs" else {"connect_timeout_s": 0.5} if case == "no hello" else {}
    given = (SCALES if case in ("quaternion", "a state") else {}) if case in UNSAID else OURS
    with speaking(handler) as address, one_line_error(PolicyError, match) as caught:
        remote(address, **given, **limits).act([query()])
    assert str(caught.value).startswith(f"policy server {address}: ")
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"execute": 5}, "execute: expected less than or equal to 1, got 5"),
        ({"address": "openpi://a:1"}, "expected vla-eval://HOST:PORT, got 'openpi://a:1'"),
    ],
)
def test_wrong_options_are_one_line(given, match):
    with one_line_error(PolicyError, f"^policy 'vla-eval': .*{match}"):
        options(**given)


def test_columns_for_another_rotation_and_other_joints_are_refused():
    with one_line_error(PolicyMismatch, "option columns: expected 8 places for a quaternion-xyzw"):
        fitted(options(columns=list(range(7)), translation_scale=1.0), {"action_spec": QUATERNIONS})
    joints = {"joints": {"dims": 7, "format": "joint_velocity"}}
    with one_line_error(
        PolicyMismatch, "expected joint_positions or joint_pos_abs of 6 numbers, as option joints says"
    ):
        fitted(options(joints=6, gripper_open=0.0, gripper_closed=1.0), {"action_spec": joints})


def test_an_episode_is_told_to_begin_and_to_end():
    messages = []
    with speaking(model(ZEROS, seen=messages)) as address:
        policy = remote(address, **OURS)
        for asked in (query(0), query(1), query(0, 1)):
            policy.act([asked])
            if asked.step:
                policy.finish([asked.episode])
        policy.close()
    kinds = ["hello", "episode_start", "observation", "observation", "episode_end", "episode_start", "observation"]
    assert [message["type"] for message in messages] == kinds
    assert messages[1]["payload"] == {"task": {"name": "reach the goal", "suite": "null"}}
    assert len({message["seq"] for message in messages}) == len(messages)


def test_a_connection_lost_at_the_start_is_opened_again_and_later_costs_the_episode():
    def cut(connection, _):
        connection.socket.close()

    with speaking(model(cut, ZEROS, cut, ZEROS)) as address:
        policy = remote(address, **OURS)
        assert not acted(policy, query())[:6].any()
        with pytest.raises(ConnectionLost):
            policy.act([query(1)])
        assert not acted(policy, query())[:6].any()


def test_a_late_answer_is_never_taken_for_the_next_querys():
    late = [lambda *_: time.sleep(0.6), ZEROS]
    with speaking(model(*late)) as address:
        policy = remote(address, **OURS, timeout_s=0.3)
        with pytest.raises(PolicyError, match="expected an answer within"):
            policy.act([query()])
        assert len(policy.act([query()])) == 1


def test_a_server_is_known_by_its_address_or_its_identity_since_it_names_no_checkpoint():
    with speaking(model(ZEROS)) as first, speaking(model(ZEROS)) as second:
        digests = {catalog.digest("vla-eval", {"address": address, **OURS}) for address in (first, second)}
        assert len(digests) == 2
        named = [{"address": address, "identity": "pi0@1", **OURS} for address in (first, second)]
        assert len({catalog.digest("vla-eval", given) for given in named}) == 1
        kind = catalog.find("vla-eval")
        assert "its server names no checkpoint" in kind.contact({"address": first, **OURS}).warning
        contact = kind.contact(named[0])
        assert contact.warning == ""
    with speaking(model(ZEROS, model_server="Another")) as other:
        policy = catalog.load("vla-eval", {**contact.options, "address": other})
        with one_line_error(PolicyError, "its metadata have changed under identity 'pi0@1'"):
            policy.act([query()])
    with one_line_error(PolicyUnreachable, "no connection"):
        remote(first, **OURS)
