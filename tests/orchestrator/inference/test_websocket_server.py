"""The server: served policies make the same rows, and no message stops the server."""

import re
import threading
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from robogauntlet.adapters.contract import Observation
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.inference.shared_policy import IdentifiedPolicy
from robogauntlet.orchestrator.inference.websocket_server import PolicyServer, ServeError, ServerOptions
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import Decision, PolicyError, PolicyInput, PolicySpec, Query
from robogauntlet.policies.function_policy import as_policy
from robogauntlet.policies.remote.msgpack_numpy import pack, unpack
from robogauntlet.policies.remote.remote_policy import ConnectionLost
from robogauntlet.results.record import outcome_row
from robogauntlet.suites.episode import Cell, Episode, Protocol, RenderProfile, View
from tests.remote_servers import serving

QUICK = {"timeout_s": 20.0, "retries": 1}


def rows(kind, options, task, seeds, *, digest=None, view=View(image_size=32), horizon=24):  # noqa: B008
    digest = digest or catalog.digest(kind, options)
    cell = Cell("policy", digest, task, Protocol(horizon, 4, view))
    runner = EpisodeRunner({"policy": PolicySource(kind, options, digest)})
    played = list(runner.play(Lease(cell, tuple(seeds))))
    runner.close()
    return [outcome_row(row) for row in played], played


def both(kind, options, task, seeds, **more):
    here, _ = rows(kind, options, task, seeds, **more)
    with serving(kind, options) as server:
        there, played = rows("openpi", {"address": server.address, **QUICK}, task, seeds, **more)
    assert [row.error for row in played] == [None] * len(played)
    assert there == here
    return played


@pytest.mark.parametrize("kind", ["untrained", "random", "zero", "oracle"])
def test_a_served_policy_makes_bit_identical_rows(kind):
    played = both(kind, {}, "null/Reach", range(6))
    assert len({row.episode_id for row in played}) == 6
    assert kind == "zero" or len({row.actions_hash for row in played}) == 6


VIEW = View(image_size=96, render_profile=RenderProfile.FAST)


@pytest.mark.simulator
@pytest.mark.parametrize(
    ("kind", "options"),
    [("mergevla-experts", {"folder": "zoo:experts"}), ("mergevla-merged", {"checkpoint": "zoo:merged"})],
)
def test_the_served_zoo_makes_bit_identical_rows(kind, options):
    pytest.importorskip("torch")
    pytest.importorskip("pybullet")
    played = both(kind, options, "pybullet/PandaReach-v3", range(2), view=VIEW, horizon=12)
    if kind == "mergevla-merged":
        assert all(row.routing_scores for row in played)


def test_a_remote_policy_of_a_plain_server_is_the_same_policy():
    with serving("untrained") as server:
        address = {"address": server.address}
        assert catalog.digest("openpi", address) == catalog.digest("untrained", {})
        assert catalog.spec("openpi", address) == catalog.spec("untrained", {})
        assert catalog.digest("openpi", {**address, "image_size": 64}) != catalog.digest("untrained", {})
        assert catalog.digest("openpi", {**address, "identity": "x"}) != catalog.digest("untrained", {})


def test_a_served_function_answers_for_the_arms_that_it_is_shown():
    def act(images, proprioception, instruction):
        return np.zeros((1, 7 * len(proprioception) // 8))

    episode = Episode("mine", "two", "null/Reach", 0, Protocol(8))
    with serving("mine", policy=as_policy(act, {}, "m:act"), digest="two") as server:
        client = catalog.load("openpi", {"address": server.address})
        client.reset([episode])
        for numbers in (8, 16):
            shown = Observation({"wrist": np.zeros((16, 16, 3), np.uint8)}, np.zeros(numbers), "")
            (decision,) = client.act([Query(episode, 0, observation=shown)])
            assert decision.actions.shape == (1, 7 * numbers // 8)
        client.close()


class Remembering:
    """Answers with the number of queries of the episode, which needs state."""

    spec = PolicySpec(PolicyInput.OBSERVATION, 4)

    def __init__(self):
        self.asked, self.threads = {}, set()

    def reset(self, episodes):
        self.asked |= {episode.id: 0 for episode in episodes}

    def act(self, queries):
        self.threads.add(threading.get_ident())
        for query in queries:
            self.asked[query.episode.id] += 1
        return [Decision(np.full((4, 7), self.asked[query.episode.id] / 1000)) for query in queries]

    def finish(self, episodes):
        for episode in episodes:
            del self.asked[episode.id]


def remembering():
    return serving("mine", policy=Remembering(), digest="remembering")


def query(step=0, seed=0):
    episode = Episode("p", "remembering", "null/Reach", seed, Protocol(60, 4, View(image_size=16)))
    images = {camera: np.zeros((16, 16, 3), np.uint8) for camera in ("third_person", "wrist")}
    return Query(episode, step, Observation(images, np.zeros(8), "reach"))


def policy_of(server, **options):
    return catalog.load("openpi", {"address": server.address, **QUICK, **options})


def settle(server, left):
    """Wait until the server has noticed disconnected clients."""
    for _ in range(200):
        if len(server.policy.asked) == left:
            return
        threading.Event().wait(0.02)
    assert len(server.policy.asked) == left


def test_the_servers_state_begins_and_ends_with_the_episode():
    with remembering() as server:
        policy = policy_of(server)
        answers = [policy.act([query(step, seed)])[0].actions[0, 0] for step, seed in ((0, 0), (0, 1), (4, 0), (8, 0))]
        assert answers == [0.001, 0.001, 0.002, 0.003]
        assert policy.act([query(0, 0)])[0].actions[0, 0] == 0.001  # begun again
        policy.finish([query(0, 0).episode, query(0, 1).episode])
        policy.act([query(0, 2)])
        settle(server, 1)
        policy.close()
        settle(server, 0)
        assert len(server.policy.threads) == 1


def test_an_episode_whose_state_is_lost_is_played_again():
    with remembering() as server:
        policy = policy_of(server)
        policy.act([query()])
        server.drop()
        with pytest.raises(ConnectionLost):
            policy.act([query(4)])
        policy.reset([query().episode])
        assert policy.act([query()])[0].actions[0, 0] == 0.001


def test_a_lost_connection_costs_no_row_and_changes_none():
    from robogauntlet.adapters.catalog import open_simulation

    def play(policy, watcher=None):
        cell = Cell("p", catalog.digest("untrained", {}), "null/Reach", Protocol(24, 4, View(image_size=32)))
        simulation = open_simulation("null/Reach", View(image_size=32))
        return [outcome_row(rollout(simulation, policy, cell.episode(seed), watcher=watcher)) for seed in range(3)]

    with serving("untrained") as server:
        cut = play(policy_of(server), lambda simulation, step: server.drop() if step == 9 else None)
    assert cut == play(catalog.load("untrained", {}))


def test_two_clients_cannot_play_one_episode_of_a_policy_with_state():
    with remembering() as server:
        first, second = policy_of(server), policy_of(server)
        first.act([query()])
        with pytest.raises(PolicyError, match="which another client plays"):
            second.act([query()])
        assert second.act([query(0, 1)])[0].actions[0, 0] == 0.001
        first.close()
        settle(server, 1)
        assert second.act([query()])[0].actions[0, 0] == 0.001


def test_simultaneous_clients_share_batches_and_get_their_own_answers():
    with serving("untrained", batch=4, wait_s=0.05) as server:
        local = catalog.load("untrained", {})

        def is_own(seed):
            one = query(0, seed)
            one.observation.images["wrist"][:] = seed
            return np.array_equal(policy_of(server).act([one])[0].actions, local.act([one])[0].actions)

        with ThreadPoolExecutor(8) as pool:
            assert list(pool.map(is_own, range(8))) == [True] * 8
        assert max(server.batches) > 1


IMAGE = np.zeros((32, 32, 3), np.uint8)
SOUND = {"observation/image": IMAGE, "observation/state": np.zeros(8, np.float32), "prompt": "reach"}
MESSAGES = {
    "text": ("hello", "expected msgpack in a binary frame, got text"),
    "no msgpack": (b"\xc1", "expected msgpack, got 1 bytes that are not"),
    "a list": (b"\x90", "expected a mapping, got list"),
    "pickled": (
        b"\x81\xa1a\x84\xc4\x0b__ndarray__\xc3\xc4\x05dtype\xa2|O\xc4\x04data\xc4\x00\xc4\x05shape\x90",
        "expected an array of numbers or text",
    ),
    "nothing": ({}, "expected an image as observation/image or observation/wrist_image, got none"),
    "other keys": ({"observation/joints": np.zeros(7)}, "got none among observation/joints"),
    "floats": ({**SOUND, "observation/image": IMAGE / 255.0}, "expected an image of bytes"),
    "flat": ({**SOUND, "observation/image": IMAGE[0]}, r"expected an image of shape \(height, width, 3\)"),
    "first channels": ({**SOUND, "observation/image": IMAGE.transpose(2, 0, 1)}, r"got \(3, 32, 32\)"),
    "no state": ({**SOUND, "observation/state": None}, "expected an array of 8 or 16 numbers as observation/state"),
    "short state": ({**SOUND, "observation/state": np.zeros(7)}, r"got shape \(7,\)"),
    "words": ({**SOUND, "prompt": 3}, "expected text as prompt, got int"),
    "episode": ({**SOUND, "robogauntlet/episode": {"seed": 1}, "robogauntlet/step": 0}, "expected an episode"),
    "step": ({**SOUND, "robogauntlet/episode": {}, "robogauntlet/step": -1}, "expected a number of steps"),
}


@pytest.fixture(scope="module")
def untrained():
    with serving("untrained", max_message_bytes=10**6) as server:
        yield server


@pytest.mark.parametrize(("message", "match"), MESSAGES.values(), ids=MESSAGES)
def test_an_invalid_message_gets_one_line_and_the_next_message_a_normal_answer(untrained, message, match):
    with connect(untrained.address) as connection:
        metadata = unpack(connection.recv())
        assert metadata["action_names"][-1] == "gripper"
        assert metadata["robogauntlet"]["digest"] == catalog.digest("untrained", {})
        connection.send(message if isinstance(message, str | bytes) else pack(message))
        line = connection.recv()
        assert isinstance(line, str)
        assert re.search(match, line)
        assert "\n" not in line
        assert "File" not in line
        connection.send(pack(SOUND))
        answer = unpack(connection.recv())
    assert answer["actions"].shape == (8, 7)
    assert answer["server_timing"]["infer_ms"] >= 0


def test_a_message_that_is_too_big_ends_its_connection_only(untrained):
    with connect(untrained.address, compression=None) as connection:
        connection.recv()
        connection.send(b"\0" * 1_100_000)
        with pytest.raises(ConnectionClosed, match="1009"):
            connection.recv()
    big = {camera: np.zeros((512, 512, 3), np.uint8) for camera in ("third_person", "wrist")}
    with pytest.raises(PolicyError, match="expected frames no larger than the server takes"):
        policy_of(untrained).act([Query(query().episode, 0, Observation(big, np.zeros(8), ""))])
    assert policy_of(untrained).act([query()])


def test_a_policy_exception_is_reported_to_its_client_in_one_line(caplog):
    class Raising(Remembering):
        def act(self, queries):
            raise RuntimeError("the fuse is blown\nat /home/me/fuse.py")

    with serving("mine", policy=Raising(), digest="x") as server:
        for _ in range(2):
            with pytest.raises(PolicyError, match=r"got an error: the policy raised RuntimeError: the fuse is blown$"):
                policy_of(server).act([query()])
    assert "the policy raised" in caplog.text


def test_a_client_that_names_no_episode_gets_its_own():
    with remembering() as server, connect(server.address) as one, connect(server.address) as other:
        found = []
        for connection in (one, one, other):
            if connection not in [c for c, _ in found]:
                connection.recv()
            connection.send(pack(SOUND))
            found.append((connection, unpack(connection.recv())["actions"][0, 0]))
        assert [value for _, value in found] == [0.001, 0.002, 0.001]


def test_a_served_oracle_reports_the_input_that_it_expects():
    with serving("oracle", task="null/Reach") as server, connect(server.address) as connection:
        connection.recv()
        connection.send(pack(SOUND))
        assert connection.recv() == "expected robogauntlet/privileged_state, on which this policy acts, got none"


def test_web_pages_and_clients_without_the_token_are_refused():
    with serving("untrained", token="sesame") as server:
        with pytest.raises(InvalidStatus, match="401"):
            connect(server.address).__enter__()
        with pytest.raises(InvalidStatus, match="401"):
            connect(server.address, additional_headers={"Authorization": "Bearer no"}).__enter__()
        shown = {"Authorization": "Bearer sesame"}
        with pytest.raises(InvalidStatus, match="403"):
            connect(server.address, origin="http://evil.example", additional_headers=shown).__enter__()
        with connect(server.address, additional_headers=shown) as connection:
            assert unpack(connection.recv())["policy"] == "untrained"


@pytest.mark.parametrize("path", ["healthz", "health"])  # openpi's, vla-evaluation-harness'
def test_the_health_check_answers(untrained, path):
    with urllib.request.urlopen(f"http://127.0.0.1:{untrained.port}/{path}", timeout=5) as answer:
        assert (answer.status, answer.read()) == (200, b"OK\n")


def test_other_machines_are_served_only_with_a_token():
    served = IdentifiedPolicy(catalog.load("zero", {}), "zero", "digest")
    for host in ("0.0.0.0", "::", "192.168.1.4", "robots.example"):
        with pytest.raises(ServeError, match="expected a token in ROBOGAUNTLET_TOKEN"):
            PolicyServer(served, ServerOptions(host))
    with (
        closing(PolicyServer(served, ServerOptions("0.0.0.0", token="x"))),
        closing(PolicyServer(served, ServerOptions("::1"))),
    ):
        pass
