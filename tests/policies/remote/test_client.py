"""The client with real servers on loopback, correct and faulty ones."""

import socket
import threading
import time

import numpy as np
import pytest

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, PolicyInput, Query
from robogauntlet.policies.remote.conversion import decode_chunk, resize_image
from robogauntlet.policies.remote.msgpack_numpy import pack, unpack
from robogauntlet.policies.remote.server_options import read_options
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.errors import one_line_error
from tests.remote_servers import answering, serving, speaking

CHUNK = {"actions": np.linspace(-0.5, 0.5, 70).reshape(10, 7)}
QUICK = {"timeout_s": 2.0, "connect_timeout_s": 1.0, "retries": 1}


def query(step=0, seed=0, task="null/Reach", joints=0):
    episode = Episode("pi0", "digest", task, seed, Protocol(60, 8, View(image_size=32)))
    generator = np.random.default_rng(seed)
    images = {name: generator.integers(0, 256, (32, 32, 3), dtype=np.uint8) for name in ("third_person", "wrist")}
    numbers = np.arange(joints + 1.0 if joints else 8.0)
    return Query(episode, step, Observation(images, numbers, "reach the goal", bool(joints)))


def remote(address, **options):
    return catalog.load("openpi", {"address": address, **QUICK, **options})


def refused(address, match, **options):
    with one_line_error(PolicyError, match) as caught:
        remote(address, **options).act([query()])
    assert address.removeprefix("ws://") in str(caught.value)


def test_the_observation_is_sent_under_openpis_keys_and_the_chunk_is_returned():
    seen = []
    with speaking(answering({**CHUNK, "server_timing": {"infer_ms": 1.0}}, seen=seen)) as address:
        policy = remote(address)
        assert (policy.spec.sees, policy.spec.cameras) == (PolicyInput.OBSERVATION, ("third_person", "wrist"))
        policy.reset([query().episode])
        (decision,) = policy.act([query()])
        policy.close()
    np.testing.assert_array_equal(decision.actions, CHUNK["actions"])
    (message,) = seen
    shown = query().observation
    assert list(message) == ["observation/image", "observation/wrist_image", "observation/state", "prompt"]
    np.testing.assert_array_equal(message["observation/wrist_image"], shown.images["wrist"])
    np.testing.assert_array_equal(message["observation/state"], shown.proprioception)
    assert message["prompt"] == "reach the goal"


@pytest.mark.parametrize("options", [{}, {"turn": "half", "image_size": 16}])
def test_the_images_that_it_shows_are_those_that_it_sends(options):
    seen = []
    with speaking(answering(CHUNK, seen=seen)) as address:
        policy = remote(address, **options)
        shown = policy.images_sent(query())
        policy.act([query()])
        policy.close()
    assert list(shown) == ["observation/image", "observation/wrist_image"]
    for key, image in shown.items():
        np.testing.assert_array_equal(image, seen[0][key])


def test_options_define_the_conversion_of_observations_and_answers():
    seen = []
    options = {
        "cameras": {"wrist": "images/hand"},
        "proprioception": None,
        "instruction": "task",
        "image_size": [20, 40],
        "actions": "chunk",
        "columns": [1, 0, 2, None, None, None, 3],
        "translation_scale": 0.05,
        "gripper_open": 1.0,
        "gripper_closed": 0.0,
        "execute": 2,
    }
    chunk = np.float32([[1, 2, 3, 1], [4, 5, 6, 0.25], [7, 8, 9, 0]])
    with speaking(answering({"chunk": chunk}, seen=seen)) as address:
        (decision,) = remote(address, **options).act([query()])
    assert set(seen[0]) == {"images/hand", "task"}
    assert seen[0]["images/hand"].shape == (20, 40, 3)
    np.testing.assert_allclose(decision.actions[:, :3], 0.05 * np.array([[2, 1, 3], [5, 4, 6]]))
    np.testing.assert_allclose(decision.actions[:, 3:], [[0, 0, 0, -1], [0, 0, 0, 0.5]])


def test_the_gripper_can_have_a_threshold_in_the_servers_units():
    options = read_options({"address": "a:1", "gripper_open": 1, "gripper_closed": 0, "gripper_threshold": 0.5})
    rows = np.zeros((3, 7))
    rows[:, 6] = [0.9, 0.1, 0.5]
    np.testing.assert_array_equal(decode_chunk(options, {"actions": rows})[:, 6], [-1, 1, -1])


def test_images_are_padded_or_stretched():
    image = np.full((32, 32, 3), 200, np.uint8)
    padded = resize_image(read_options({"address": "a:1", "image_size": [20, 40]}), image)
    assert padded.shape == (20, 40, 3)
    assert not padded[:, :10].any()
    assert (padded[:, 10:30] == 200).all()
    stretch = read_options({"address": "a:1", "image_size": [20, 40], "resize": "stretch"})
    assert (resize_image(stretch, image) == 200).all()
    assert resize_image(read_options({"address": "a:1", "image_size": 32}), image) is image


def wrong(chunk):
    return answering({"actions": chunk})


NAN, INFINITE = np.zeros((2, 4, 7))
NAN[1, 2] = np.nan
INFINITE[0, 6] = np.inf
ANSWERS = {
    "no key": (answering({"action": np.zeros((4, 7))}), "expected 'actions' in the answer, got action; set option"),
    "too wide": (wrong(np.zeros((4, 8))), r"expected 'actions' of shape \(n, 7\).* got \(4, 8\); choose the action"),
    "too narrow": (wrong(np.zeros((4, 6))), r"got \(4, 6\)"),
    "one row": (wrong(np.zeros(7)), r"got \(7,\)"),
    "empty": (wrong(np.zeros((0, 7))), r"got \(0, 7\)"),
    "endless": (wrong(np.zeros((1001, 7))), r"got \(1001, 7\)"),
    "NaN": (wrong(NAN), "expected finite numbers as 'actions', got nan in row 1, column 2"),
    "infinite": (wrong(INFINITE), "expected finite numbers as 'actions', got inf in row 0, column 6"),
    "text": (wrong("left a bit"), "expected numbers as 'actions', got str"),
    "ragged": (wrong([[1.0], [1.0, 2.0]]), "expected numbers as 'actions', got list"),
    "a list": (answering(b"\x93\x01\x02\x03"), "a mapping, got list"),
    "no msgpack": (answering(b"\xc1\xff\x00"), "expected an answer: expected msgpack, got 3 bytes that are not"),
    "pickle": (answering(b"\x80\x04\x95\x1d\x00"), "expected an answer: expected"),
    "objects": (
        answering(b"\x81\xa1a\x84\xc4\x0b__ndarray__\xc3\xc4\x05dtype\xa2|O\xc4\x04data\xc4\x00\xc4\x05shape\x90"),
        "expected an array of numbers or text, got type '|O'".replace("|", r"\|"),
    ),
    "text frame": (
        answering('Traceback (most recent call last):\n  File "/home/x/serve.py"\nKeyError: "observation/joint"\n'),
        'got an error: KeyError: "observation/joint"$',
    ),
    "empty text": (answering(""), r"got an error: no message"),
    "too big": (answering(b"\0" * (17 * 2**20)), "expected frames no larger than 16 MiB, got one"),
    "late": (answering(lambda c, f: time.sleep(1.0)), r"expected an answer within 0\.3 s, got none; raise timeout_s"),
}


@pytest.mark.parametrize(("handler", "match"), ANSWERS.values(), ids=ANSWERS)
def test_a_wrong_answer_is_one_line(handler, match):
    with speaking(handler) as address:
        refused(address, match, **({"timeout_s": 0.3} if "0\\.3" in match else {}))


GREETINGS = {
    "text": (lambda c: c.send("busy"), "expected metadata on connection.* got an error: busy"),
    "no msgpack": (lambda c: c.send(b"\xc1"), "expected metadata on connection"),
    "a list": (lambda c: c.send(b"\x90"), "a mapping, got list"),
    "nothing": (lambda c: time.sleep(1.2), "got nothing in time; is it another kind of server"),
    "hangs up": (lambda c: c.close(), "got none: it closed the connection"),
    "another version": (lambda c: c.send(pack({"robogauntlet": {"version": 99}})), "of version 1, got version 99"),
    "broken": (lambda c: c.send(pack({"robogauntlet": {"version": 1}})), "expected the policy's needs"),
}


@pytest.mark.parametrize(("handler", "match"), GREETINGS.values(), ids=GREETINGS)
def test_a_wrong_greeting_is_one_line(handler, match):
    with speaking(handler) as address:
        refused(address, match)


def test_a_server_of_something_else_is_one_line():
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def talk():
            for _ in range(2):
                caller, _ = listening.accept()
                caller.recv(1000)
                caller.sendall(b"SSH-2.0-OpenSSH_9.6\r\n")
                caller.close()

        thread = threading.Thread(target=talk)
        thread.start()
        refused(f"ws://127.0.0.1:{listening.getsockname()[1]}", "it is no websocket server")
        thread.join()


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        return listening.getsockname()[1]


def test_an_unreachable_server_is_one_line_when_planned_and_when_played():
    address = f"ws://127.0.0.1:{free_port()}"
    refused(address, "within 2 attempts and 1 s, got none: no connection: connection refused; start the server")
    refused(address, "no connection", identity="pi0", timeout_s=1.0)
    with pytest.raises(PolicyError, match="no connection"):
        catalog.digest("openpi", {"address": address, **QUICK})


def test_a_server_may_restart_between_two_queries():
    with speaking(answering(CHUNK)) as address:
        policy = remote(address, retries=30, timeout_s=10)
        assert len(policy.act([query()])) == 1
        port = int(address.rpartition(":")[2])
    restarted = []

    def again():
        time.sleep(0.4)
        with speaking(answering(CHUNK), port=port):
            restarted.append(True)
            done.wait(10)

    done = threading.Event()
    thread = threading.Thread(target=again)
    thread.start()
    (decision,) = policy.act([query(8)])
    done.set()
    thread.join()
    assert restarted
    np.testing.assert_array_equal(decision.actions, CHUNK["actions"])


def test_a_query_is_repeated_after_a_lost_connection():
    asked = []

    def once(connection):
        connection.send(pack({"model": "test"}))
        for frame in connection:
            asked.append(frame)
            if len(asked) == 1:
                connection.socket.shutdown(socket.SHUT_RDWR)
            else:
                connection.send(pack(CHUNK))

    with speaking(once) as address:
        assert len(remote(address).act([query()])) == 1
    assert len(asked) == 2
    assert asked[0] == asked[1]


def test_a_late_answer_is_never_taken_for_the_next_querys():
    turns = iter(range(10))

    def handle(connection):
        connection.send(pack({"model": "test"}))
        for _ in connection:
            turn = next(turns)
            time.sleep(0.6 if turn == 0 else 0)
            connection.send(pack({"actions": np.full((1, 7), float(turn))}))

    with speaking(handle) as address:
        policy = remote(address, timeout_s=0.3)
        with pytest.raises(PolicyError, match="expected an answer within"):
            policy.act([query()])
        time.sleep(0.5)
        assert policy.act([query()])[0].actions[0, 0] == 1.0


def test_two_queries_are_answered_in_order():
    def states(connection, frame):
        return {"actions": np.full((1, 7), float(unpack(frame)["observation/image"][0, 0, 0]))}

    with speaking(answering(states)) as address:
        decisions = remote(address).act([query(seed=1), query(seed=2)])
    expected = [query(seed=seed).observation.images["third_person"][0, 0, 0] for seed in (1, 2)]
    assert [decision.actions[0, 0] for decision in decisions] == expected


OPTIONS = {
    "no address": ({}, "address: Field required"),
    "http": ({"address": "http://x"}, "address: expected openpi://HOST:PORT, got 'http://x'"),
    "password": ({"address": "ws://me:secret@x"}, "expected openpi://HOST:PORT"),
    "port": ({"address": "ws://x:99999"}, "expected openpi://HOST:PORT"),
    "camera": ({"cameras": {"left": "a"}}, "cameras: expected some of third_person, wrist, got left"),
    "no camera": ({"cameras": {}}, "got none"),
    "one key": ({"cameras": {"wrist": "prompt"}}, "expected another key for each part"),
    "columns": ({"columns": [0, 1]}, "columns: expected 7 places, got 2"),
    "column": ({"columns": [-1] * 7}, "columns.0"),
    "columns of a quaternion": (
        {"rotation": "quaternion-xyzw", "columns": [0, 1, 2, 3, 4, 5, 6]},
        "columns: expected 8 places for a quaternion-xyzw, got 7",
    ),
    "no quaternion": (
        {"rotation": "quaternion-wxyz", "columns": [0, 1, 2, None, None, None, None, 3]},
        "columns: a quaternion is never all 0",
    ),
    "unit of a quaternion": (
        {"rotation": "quaternion-wxyz", "rotation_scale": 0.5},
        "rotation_scale: quaternions have",
    ),
    "rotation": ({"rotation": "rpy"}, "rotation: expected 'axis-angle', 'euler'"),
    "gripper": ({"gripper_open": 1.0}, "expected gripper_open other than gripper_closed"),
    "scale": ({"translation_scale": float("nan")}, "translation_scale"),
    "size": ({"image_size": 8}, "image_size"),
    "timeout": ({"timeout_s": 0}, "timeout_s"),
    "secret": (
        {"token_variable": "WANDB_API_KEY"},
        "token_variable: expected ROBOGAUNTLET_POLICY_TOKEN or .*, since a suite names no other secret; got",
    ),
    "another of ours": ({"token_variable": "ROBOGAUNTLET_TOKEN"}, "got 'ROBOGAUNTLET_TOKEN'"),
    "in clear": (
        {"address": "ws://far.example:1", "token_variable": "ROBOGAUNTLET_POLICY_TOKEN"},
        "token_variable: a token is sent over wss:// or to this machine only, got ws://far.example:1",
    ),
    "unknown": ({"adress": "x"}, "adress: Extra inputs are not permitted"),
}


@pytest.mark.parametrize(("options", "match"), OPTIONS.values(), ids=OPTIONS)
def test_wrong_options_are_one_line(options, match):
    given = options if "address" in options or not options else {"address": "ws://x:1", **options}
    with one_line_error(PolicyError, f"^policy 'openpi': .*{match}"):
        catalog.spec("openpi", given)


def test_a_token_is_read_from_the_environment_and_sent(monkeypatch):
    hand = "ROBOGAUNTLET_POLICY_TOKEN_HAND"
    with serving("untrained", token="open sesame") as server:
        refused(server.address, "expected a websocket, got HTTP 401; give its token by option token_variable")
        refused(server.address, f"expected its token in the environment variable {hand}, got none", token_variable=hand)
        monkeypatch.setenv(hand, "wrong")
        refused(server.address, "got HTTP 401", token_variable=hand)
        monkeypatch.setenv(hand, "open sesame")
        for scheme in ("Bearer", "Api-Key"):
            policy = remote(server.address, token_variable=hand, token_scheme=scheme)
            assert policy.act([query()])[0].actions.shape == (8, 7)


@pytest.mark.parametrize("address", ["ws://{}", "ws://localhost.far.example:1"])
def test_a_secret_of_another_name_or_in_clear_goes_to_no_server(monkeypatch, address):
    monkeypatch.setenv("WANDB_API_KEY", "my-secret")
    monkeypatch.setenv("ROBOGAUNTLET_POLICY_TOKEN", "my-secret")
    seen = []
    with speaking(answering(CHUNK), process_request=lambda _, request: seen.append(str(request.headers))) as here:
        variable = "WANDB_API_KEY" if "{}" in address else "ROBOGAUNTLET_POLICY_TOKEN"
        with one_line_error(PolicyError, "token_variable: ") as caught:
            remote(address.format(here.removeprefix("ws://")), token_variable=variable)
        assert remote(here, token_variable="ROBOGAUNTLET_POLICY_TOKEN").act([query()])
    assert "my-secret" not in str(caught.value)
    assert [headers.count("my-secret") for headers in seen] == [1]
