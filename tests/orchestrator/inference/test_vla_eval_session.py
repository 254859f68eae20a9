"""Policies behind vla-evaluation-harness' protocol: its own software and our client play them, and bad messages."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.inference.shared_policy import IdentifiedPolicy
from robogauntlet.orchestrator.inference.websocket_server import PolicyServer, ServeError, ServerOptions
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import Decision, PolicyInput, PolicyMismatch, PolicySpec, Query
from robogauntlet.policies.remote.msgpack_numpy import pack, unpack
from robogauntlet.policies.remote.server_options import WireProtocol
from robogauntlet.policies.remote.vla_eval_messages import Kind, message_of, received
from robogauntlet.results.record import outcome_row
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.errors import one_line_error
from tests.orchestrator.cli.test_serve import served
from tests.orchestrator.inference.test_websocket_server import settle
from tests.policies.remote.test_vla_eval_server import BROKEN, IMAGE, OURS, SOUND, SPEC, compressed
from tests.remote_servers import serving

VIEW = View(image_size=32)


@pytest.fixture(scope="module")
def untrained():
    """The command, in a process."""
    with served("untrained", "--protocol", "vla-eval") as server:
        yield server


def toy_benchmark(seen):
    """The null simulator as a benchmark of theirs; `seen` gets each observation and the action that answered it."""
    from vla_eval import specs
    from vla_eval.benchmarks.base import StepBenchmark, StepResult

    class Toy(StepBenchmark):
        def get_tasks(self):
            return [{"name": "reach", "suite": "toy"}]

        def get_action_spec(self):
            return {"position": specs.POSITION_DELTA, "rotation": specs.ROTATION_AA, "gripper": specs.GRIPPER_CLOSE_POS}

        def get_observation_spec(self):
            images = {"agentview": specs.IMAGE_RGB, "wrist": specs.IMAGE_RGB}
            return images | {"state": specs.STATE_EEF_POS_AA_GRIP, "language": specs.LANGUAGE}

        def reset(self, task):
            self.simulation = open_simulation("null/Reach", VIEW)
            self.simulation.reset(task.get("episode_idx", 0))
            return self.simulation.observe()

        def step(self, action):
            seen.append((self._last_result.obs, action["actions"]))
            outcome = self.simulation.step(np.clip(action["actions"], -1.0, 1.0))
            return StepResult(self.simulation.observe(), outcome.reward, outcome.success, {})

        def make_obs(self, raw, task):
            images = dict(zip(("agentview", "wrist"), raw.images.values(), strict=True))
            return {"images": images, "states": raw.proprioception, "task_description": raw.instruction}

        def get_step_result(self, result):
            return {"success": result.done}

    return Toy()


def test_their_runner_plays_an_episode_with_the_policys_own_actions(untrained):
    anyio = pytest.importorskip("anyio")
    connection = pytest.importorskip("vla_eval.connection")
    from vla_eval.runners.sync_runner import SyncEpisodeRunner
    from vla_eval.specs import DimSpec, check_specs

    seen = []
    toy = toy_benchmark(seen)

    async def play():
        async with connection.Connection(untrained.address) as client:
            said = client.server_info
            specs = [
                {name: DimSpec.from_dict(part) for name, part in said[f"{of}_spec"].items()}
                for of in ("action", "observation")
            ]
            assert check_specs(specs[0], toy.get_action_spec(), specs[1], toy.get_observation_spec()) == []
            return said, await SyncEpisodeRunner().run_episode(toy, toy.get_tasks()[0], client, max_steps=20)

    said, result = anyio.run(play)
    assert result["steps"] == len(seen) == 20
    assert said["observation_params"] == {"send_wrist_image": True, "send_state": True}
    assert (said["policy"], said["digest"]) == ("untrained", catalog.digest("untrained", {}))
    policy, episode = catalog.load("untrained", {}), Episode("p", "d", "null/Reach", 0, Protocol(20))
    chunks = [policy.act([Query(episode, step, seen[step][0])])[0].actions for step in (0, 8, 16)]
    np.testing.assert_array_equal([action for _, action in seen], np.concatenate(chunks)[:20])


def test_our_client_plays_the_same_rows_as_without_a_server(untrained):
    episodes = [
        Episode("p", catalog.digest("untrained", {}), "null/Reach", seed, Protocol(24, 8, VIEW)) for seed in (0, 1)
    ]
    address = {"address": untrained.address, **OURS}
    results = [
        [rollout(open_simulation("null/Reach", VIEW), policy, episode) for episode in episodes]
        for policy in (catalog.load("untrained", {}), catalog.load("vla-eval", address))
    ]
    assert [[row.queries for row in rows] for rows in results] == [[3, 3], [24, 24]]  # the server keeps the chunk
    here, there = ([outcome_row(replace(row, queries=0)) for row in rows] for rows in results)
    assert here == there
    assert len({row.actions_hash for row in results[0]}) == 2


class Counting:
    """Answers with the number of its queries in the episode and the episode's seed, which needs state."""

    spec = SPEC

    def __init__(self, chunk=1):
        self.asked, self.chunk = {}, chunk

    def reset(self, episodes):
        self.asked |= {episode.id: 0 for episode in episodes}

    def act(self, queries):
        for query in queries:
            self.asked[query.episode.id] += 1
        return [
            Decision(np.tile([self.asked[query.episode.id], query.episode.seed, 0, 0, 0, 0, 1.0], (self.chunk, 1)))
            for query in queries
        ]

    def finish(self, episodes):
        for episode in episodes:
            del self.asked[episode.id]


class Client:
    """Sends messages and reads answers, one by one."""

    def __init__(self, connection):
        self.connection, self.number = connection, 0

    def tell(self, kind, **payload):
        self.number += 1
        self.connection.send(pack(message_of(kind, payload, self.number)))

    def start(self, **task):
        self.tell(Kind.EPISODE_START, task=task)

    def read(self):
        """The payload of the next answer, its numbers as a list or its error."""
        answer = unpack(self.connection.recv(timeout=10))
        assert answer["seq"] == self.number
        assert set(answer) == {"type", "payload", "seq", "timestamp"}
        return answer["payload"]["error"] if answer["type"] == "error" else received(answer["payload"].get("actions"))

    def act(self, **changes):
        self.tell(Kind.OBSERVATION, **{**SOUND, **changes})
        return self.read()

    def counts(self):
        """Queries of the episode so far, and its seed."""
        return [int(number) for number in self.act()[:2]]


def speaking_theirs(policy=None, **place):
    given = {"policy": policy, "digest": "mine"} if policy else {}
    return serving("untrained", protocol=WireProtocol.VLA_EVAL, **given, **place)


def test_an_episodes_state_begins_with_its_start_and_ends_with_its_end_or_its_client():
    with speaking_theirs(Counting()) as server:
        with connect(server.address) as first, connect(server.address) as second:
            one, other = Client(first), Client(second)
            one.start(name="a", episode_idx=5)
            assert [one.counts(), one.counts()] == [[1, 5], [2, 5]]
            assert [one.ping_interval for one in server.listening.connections] == [None] * 2  # a reset may take minutes
            other.start(name="a", episode_idx=5)  # is played already, so it is the next
            assert [other.counts(), one.counts()] == [[1, 6], [3, 5]]
            one.start(name="b")  # without an end
            assert one.counts() == [1, 0]
            other.tell(Kind.EPISODE_END, metrics={"success": True})
            assert other.act() == "expected episode_start before the first observation, got none"
            assert len(server.policy.asked) == 1
        settle(server, 0)


@pytest.mark.parametrize(("execute", "executed"), [(None, 8), (2, 8), (9, 9)])
def test_a_chunk_is_kept_for_as_many_steps_as_a_run_executes_and_never_for_the_next_episode(execute, executed):
    with speaking_theirs(Counting(chunk=10), execute=execute) as server, connect(server.address) as connection:
        client = Client(connection)
        client.start(episode_idx="last")
        assert [client.counts() for _ in range(10)] == [[1, 0]] * executed + [[2, 0]] * (10 - executed)
        client.start()
        assert client.counts()[0] == 1


def test_an_error_at_the_start_answers_the_first_observation():
    class Refusing(Counting):
        def reset(self, episodes):
            raise PolicyMismatch("it cannot act in\nthis")

    with speaking_theirs(Refusing()) as server, connect(server.address) as connection:
        client = Client(connection)
        client.start()
        assert [client.act(), client.act()] == ["it cannot act in this"] * 2


HELLO = {"harness_version": "0.8.0", "protocol_version": 1}
CALVIN = HELLO | {"benchmark": "vla_eval.benchmarks.calvin.benchmark:CALVINBenchmark"}
LARGE = compressed(np.zeros((2, 2000, 3), np.uint8), "png")
BAD = {
    "text": ("hello", "expected msgpack in a binary frame, got text"),
    "no msgpack": (b"\xc1", "expected msgpack, got 1 bytes that are not"),
    "a list": (b"\x90", "expected a mapping, got list"),
    "another protocol's": (
        pack({"prompt": "reach"}),
        "expected a message hello, .*, error with a mapping .* got 'None' with ",
    ),
    "a kind": (pack({"type": ["x"], "payload": {}}), r"expected a message .* got '\['x'\]' with dict"),
    "no payload": (pack({"type": "observation", "payload": [1]}), "expected a message .* got 'observation' with list"),
    "version 2": (
        (Kind.HELLO, HELLO | {"protocol_version": 2}),
        "expected a client of protocol version 1, got version 2",
    ),
    "no version": ((Kind.HELLO, {}), "expected a client of protocol version 1, got version None"),
    "not begun": ((Kind.OBSERVATION, SOUND), "expected episode_start before the first observation, got none"),
}
SHOWN = {
    "no images": ({"images": None}, "expected an image as agentview or wrist, got none among state, task_description"),
    "other images": (
        {"images": {"primary": IMAGE}},
        "expected an image as agentview or wrist, got none among primary, ",
    ),
    "floats": (
        {"images": {"agentview": IMAGE / 255.0}},
        "expected an image of bytes, .* as agentview, got type float64",
    ),
    "bytes": ({"images": {"agentview": b"png"}}, "expected an image of bytes, .* as agentview, got a bytes"),
    "flat": ({"images": {"agentview": IMAGE[0]}}, r"expected an image of shape .* as agentview, got \(32, 3\)"),
    "too large": ({"images": {"agentview": LARGE}}, "expected images of 1024 px at most, got 2 x 2000"),
    "broken": ({"images": {"agentview": BROKEN}}, "expected an image as PNG or JPEG, got 13 bytes that are none"),
    "no data": ({"images": {"agentview": BROKEN | {"data": None}}}, "expected an image's bytes, got NoneType"),
    "short": ({"images": {"agentview": {"__ndarray__": True, "dtype": "|u1", "shape": [9]}}}, "got 0 bytes"),
    "no state": ({"states": None}, "expected an array of 8 numbers as state, got a NoneType"),
    "a joint state": ({"states": np.zeros(9)}, r"expected an array of 8 numbers as state, got shape \(9,\)"),
    "words": ({"task_description": 3}, "expected text as task_description, got int"),
    "many words": ({"task_description": "a" * 1001}, "expected at most 1000 characters as task_description, got 1001"),
}


@pytest.fixture(scope="module")
def counting():
    with speaking_theirs(Counting(), max_message_bytes=10**6) as server:
        yield server


def is_served(server):
    with connect(server.address) as connection:
        client = Client(connection)
        client.start()
        return client.counts()[0] == 1


@pytest.mark.parametrize(("message", "match"), BAD.values(), ids=BAD)
def test_a_message_that_is_none_gets_one_line_and_the_server_lives_on(counting, message, match):
    with connect(counting.address) as connection:
        client = Client(connection)
        if isinstance(message, tuple):
            client.tell(message[0], **message[1])
        else:
            connection.send(message)
        line = client.read()
        assert re.match(match, line)
        assert "\n" not in line
        client.start()
        assert client.counts()[0] == 1


@pytest.mark.parametrize(("changes", "match"), SHOWN.values(), ids=SHOWN)
def test_an_observation_that_cannot_be_read_gets_one_line_and_the_episode_goes_on(counting, changes, match):
    with connect(counting.address) as connection:
        client = Client(connection)
        client.start()
        line = client.act(**changes)
        assert re.search(match, line)
        assert "\n" not in line
        assert client.counts()[0] == 1


STARTS = {
    "no task": (HELLO, {}, "expected a task as a mapping in episode_start, got NoneType"),
    "other units": (
        CALVIN,
        {"task": {"suite": "calvin"}},
        "expected a suite of LIBERO or a benchmark in .* got calvin",
    ),
    "an unknown scene": (
        HELLO,
        {"task": {"suite": "libero_90", "task_id": 3}},
        "expected a task of LIBERO, got libero/90-3",
    ),
}


@pytest.mark.parametrize(("hello", "start", "match"), STARTS.values(), ids=STARTS)
def test_an_episode_that_cannot_be_played_is_one_line(counting, hello, start, match):
    with connect(counting.address) as connection:
        client = Client(connection)
        client.tell(Kind.HELLO, **hello)
        client.read()
        client.tell(Kind.EPISODE_START, **start)
        assert re.search(match, client.act())


def test_a_message_that_is_too_big_ends_its_connection_only(counting):
    with connect(counting.address, compression=None) as connection:
        connection.send(b"\0" * 1_100_000)
        with pytest.raises(ConnectionClosed, match="1009"):
            connection.recv()
    assert is_served(counting)


@pytest.mark.parametrize(
    ("spec", "match"),
    [
        (PolicySpec(PolicyInput.PRIVILEGED_STATE, 1), "expected a policy that sees observations, got one that acts on"),
        (PolicySpec(PolicyInput.OBSERVATION, 1, 14), "expected a policy of one arm, got one of two"),
    ],
)
def test_a_policy_that_the_protocol_cannot_describe_is_refused_before_it_is_served(spec, match):
    policy = SimpleNamespace(spec=spec, act=None)
    with one_line_error(ServeError, f"^protocol vla-eval: {match}"):
        PolicyServer(IdentifiedPolicy(policy, "p", "d"), ServerOptions(protocol=WireProtocol.VLA_EVAL))
