"""HTTP servers of OpenVLA: one written from the contract, in a thread, and what it answers when it is faulty."""

import contextlib
import json
import socket
import threading
import time

import numpy as np
import pytest

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, PolicyUnreachable
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.errors import one_line_error
from tests.policies.remote.test_client import query
from tests.remote_servers import speaking

servers = pytest.importorskip("tests.policies.remote.openvla_server")
serving, chunk = servers.serving, servers.chunk

QUICK = {"timeout_s": 5.0, "connect_timeout_s": 2.0, "retries": 0}
UNITS = {"translation_scale": 0.1, "rotation": "euler", "rotation_scale": 1.0, "gripper_open": 1, "gripper_closed": 0}
OFT = {"cameras": {"third_person": "full_image", "wrist": "wrist_image"}, "proprioception": "state"}


def remote(address, **options):
    return catalog.load("openvla", {"address": address, **QUICK, **options})


@pytest.mark.parametrize("encoded", [False, True])
def test_an_observation_is_posted_and_one_action_read_in_both_forms(encoded):
    seen, asked = [], query()
    with serving(seen=seen) as address:
        policy = remote(address, **UNITS, encoded=encoded, unnorm_key="bridge_orig")
        (decision,) = policy.act([asked])
    assert seen[0].keys() == {"image", "instruction", "unnorm_key"}
    np.testing.assert_array_equal(seen[0]["image"], asked.observation.images["third_person"])
    assert (seen[0]["instruction"], seen[0]["unnorm_key"]) == (asked.observation.instruction, "bridge_orig")
    first = asked.observation.images["third_person"][0, 0, 0] / 255
    np.testing.assert_allclose(decision.actions, [[0.1 * first, 0, 0, 0, 0, 0, -1.0]])
    assert list(policy.images_sent(asked)) == ["image"]


@pytest.mark.parametrize("encoded", [False, True])
def test_a_chunk_of_openvla_oft_is_read_and_the_wrist_and_the_state_are_sent(encoded):
    asked = query()
    with serving(chunk) as address:
        (decision,) = remote(address, **UNITS, **OFT, execute=5, encoded=encoded).act([asked])
    shown = [asked.observation.images["wrist"][0, 0, 0] / 255, asked.observation.proprioception.sum()]
    np.testing.assert_allclose(decision.actions[:, :3], [[0.1 * step, *np.multiply(0.1, shown)] for step in range(5)])


@pytest.mark.parametrize(
    "answer", [[0.0] * 7, [[0.0] * 7] * 3, {"action": [[0.0] * 7]}, np.zeros((3, 7), np.float32), [np.zeros(7)] * 2]
)
def test_lists_arrays_and_mappings_are_chunks(answer):
    with serving(lambda _: answer) as address:
        (decision,) = remote(address, **UNITS).act([query()])
    assert decision.actions.shape == (len(answer) if np.ndim(answer) == 2 else 1, 7)


def test_an_episode_is_played_and_again_with_the_same_row():
    episode = Episode("openvla", "digest", "null/Reach", 0, Protocol(12, 8, View(image_size=32)))
    with serving() as address:
        policy, simulation = remote(address, **UNITS), open_simulation("null/Reach", View(image_size=32))
        first, again = (rollout(simulation, policy, episode) for _ in range(2))
    assert (first.steps, first.actions_hash) == (12, again.actions_hash)


def test_a_check_plays_it(run_command, tmp_path):
    with serving(chunk) as address:
        given = [f"--option={name}={json.dumps(value)}" for name, value in (OFT | UNITS).items()]
        picture = ("--picture", str(tmp_path / "check.png"))
        done = run_command("check", "policy", address, *given, "--task", "null/Reach", *picture)
    assert "chunks of 8 actions" in done.out, done.err
    assert "the same episode after another one: the same actions" in done.out


def test_a_token_is_sent(monkeypatch):
    monkeypatch.setenv("ROBOGAUNTLET_POLICY_TOKEN", "sesame")
    with serving(token="sesame") as address:
        assert remote(address, **UNITS, token_variable="ROBOGAUNTLET_POLICY_TOKEN").act([query()])
        with one_line_error(PolicyError, "got HTTP 401; give its token by option token_variable"):
            remote(address, **UNITS).act([query()])
    with one_line_error(PolicyError, "token_variable: a token is sent over https:// or to this machine only"):
        remote("openvla+http://far:1", **UNITS, token_variable="ROBOGAUNTLET_POLICY_TOKEN")


def says(value):
    return lambda _: value


SLOW = {"timeout_s": 0.2}
ARRAY = {"__numpy__": "AAAA", "dtype": "<f8", "shape": [10**9, 7]}
BAD = {
    "error": (says("error"), {}, "expected an action, got 'error'; its log says why; see options cameras, "),
    "no camera": (chunk, {}, "expected an action, got 'error'; its log says why"),
    "one action": (says([0.0] * 7), {"execute": 5}, "option execute: expected 5 actions or more, got 1"),
    "narrow": (says([0.0] * 6), {}, r"expected 'action' of shape \(n, 7\), .*, got \(1, 6\)"),
    "wide": (says(np.zeros(8)), {}, r"expected 'action' of shape \(n, 7\), .*, got \(1, 8\).* option columns"),
    "many": (says(np.zeros((1001, 7))), {}, r"n from 1 to 1000, got \(1001, 7\)"),
    "deep": (says(np.zeros((1, 2, 7))), {}, r"expected 'action' of shape \(n, 7\), .*, got \(1, 2, 7\)"),
    "ragged": (says([[0.0], [0.0, 1.0]]), {}, "expected numbers as 'action', got list of type object"),
    "NaN": (says([float("nan")] + [0.0] * 6), {}, "expected finite numbers as 'action', got nan in row 0, column 0"),
    "infinite": (says((200, "[1e999,0,0,0,0,0,0]")), {}, "expected finite numbers as 'action', got inf in row 0"),
    "words": (says(["left"]), {}, "expected numbers as 'action', got list of type"),
    "nothing": (says(None), {}, "expected numbers as 'action', got list of type object"),
    "a key": (says({"actions": [0]}), {}, "expected 'action' in the answer, got actions; set option actions"),
    "keys": (says([0.0]), {"actions": ["arm", "hand"]}, "expected a mapping with arm, hand, got an array; leave out"),
    "an array": (says((200, json.dumps(ARRAY))), {}, "expected an array of type float64 and shape .*, got 3 bytes"),
    "objects": (says((200, json.dumps(ARRAY | {"dtype": "|O"}))), {}, "expected an array of numbers or text, got type"),
    "base64": (says((200, json.dumps(ARRAY | {"__numpy__": 5}))), {}, "expected an array's bytes in base64"),
    "HTML": (says((200, "<html>")), {}, "expected JSON, got 6 bytes that are not"),
    "nested": (says((200, "[" * 100_000)), {}, "expected JSON, got 100000 bytes that are not"),
    "levels": (says((200, "[" * 600 + "]" * 600)), {}, "expected 32 levels of lists and mappings at most, got more"),
    "text": (says((200, '"[1,"')), {}, "expected JSON, got 3 bytes that are not"),
    "too large": (says((200, b" " * 2**21)), {}, "expected an answer of at most 1 MiB, got a larger one"),
    "invalid": (says((422, '{"detail": "no image"}')), {}, 'got HTTP 422: {"detail": "no image"}'),
    "redirect": (says((307, "")), {}, "got HTTP 307, a redirect, which is not followed; correct the address"),
    "busy": (says((503, "")), {}, "within 1 attempts and 5 s, got none: it answered with HTTP 503"),
    "late": (lambda _: time.sleep(0.3), SLOW, r"expected an answer within 0\.2 s, got none; raise timeout_s"),
}


@pytest.mark.parametrize(("answer", "options", "match"), BAD.values(), ids=BAD)
def test_a_faulty_answer_is_one_line(answer, options, match):
    with serving(answer) as address, one_line_error(PolicyError, match) as caught:
        remote(address, **UNITS, **options).act([query()])
    assert str(caught.value).startswith(f"policy server {address.removeprefix('openvla+')}/act: ")
    assert len(str(caught.value)) < 600


def test_an_answer_in_drops_is_late_too():
    def drip(listening):
        connection, _ = listening.accept()
        with connection, contextlib.suppress(OSError):
            connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n")
            for _ in range(10):
                time.sleep(0.05)
                connection.sendall(b" ")

    with socket.create_server(("127.0.0.1", 0)) as listening:
        threading.Thread(target=drip, args=(listening,), daemon=True).start()
        with one_line_error(PolicyError, "got nothing in time; is it another kind of server"):
            remote(f"openvla+http://127.0.0.1:{listening.getsockname()[1]}", **UNITS, connect_timeout_s=0.2)


def test_another_address_another_kind_of_server_and_none_are_one_line():
    with serving() as address, one_line_error(PolicyError, "/predict: expected .*, got HTTP 404; correct the address"):
        remote(f"{address}/predict", **UNITS)
    with speaking(lambda _: None) as address, one_line_error(PolicyError, "got HTTP 426; correct the address"):
        remote(address.replace("ws", "openvla+http"), **UNITS)
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        port = nobody.getsockname()[1]
    with one_line_error(PolicyUnreachable, "no connection: .*label .*too long"):
        remote(f"openvla+http://{'a' * 70}.example:1", **UNITS)
    with one_line_error(PolicyUnreachable, "no connection: connection refused; start the server"):
        remote(f"openvla+http://127.0.0.1:{port}", **UNITS)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({}, "its servers do not say translation_scale, rotation, .*; give each by an option, or all by option conv"),
        ({"address": "ws://a:1"}, r"address: expected openvla\+http://HOST:PORT/act, got 'ws://a:1'"),
        ({"address": "openvla+http://me:pw@a:1"}, r"expected openvla\+http://HOST:PORT/act, got one with a user"),
        ({"unnorm_key": 5}, "unnorm_key: expected a valid string, got 5"),
        ({"encoded": "maybe"}, "encoded: expected a valid boolean"),
    ],
)
def test_wrong_options_are_one_line(given, match):
    with one_line_error(PolicyError, f"^policy 'openvla': .*{match}"):
        remote(**({"address": "a:1"} | given))


def test_a_server_is_known_by_its_address_or_its_identity_and_the_form_of_its_messages_does_not_matter():
    with serving() as address:
        kind, plain = catalog.find("openvla"), {"address": address, **UNITS}
        assert "says nothing of itself" in kind.contact(plain).warning
        digests = [catalog.digest("openvla", plain | more) for more in ({}, {"encoded": True}, {"unnorm_key": "a"})]
        assert digests[0] == digests[1] != digests[2]
        named = {**plain, "identity": "openvla@1"}
        assert kind.contact(named).warning == ""
    assert kind.digest_without_start(named) == kind.digest_without_start({**named, "address": "elsewhere:1"})
