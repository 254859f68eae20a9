"""Policy servers that are Ray actors, which answer the queries of all workers in batches."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Literal

import ray
from ray.exceptions import RayError

from robogauntlet.adapters.catalog import stand_in_spec
from robogauntlet.adapters.contract import black_observation
from robogauntlet.orchestrator.environments.resolver import ONE_THREAD
from robogauntlet.orchestrator.episodes.policy_source import PolicySource, build_policy, resolve_locally
from robogauntlet.orchestrator.inference.batcher import Batcher
from robogauntlet.orchestrator.inference.planned_policy import planned_spec
from robogauntlet.orchestrator.ray_runtime.session import answer, check_room, in_session
from robogauntlet.orchestrator.scheduling.worker_pool import WorkerPoolError
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import Decision, Policy, PolicyInput, PolicySpec, Query
from robogauntlet.suites.episode import Cell, Episode
from robogauntlet.support.errors import last_line

if TYPE_CHECKING:
    from robogauntlet.suites.resources import Inference

TIMES = 5
"""Queries over which a time is averaged."""
MAX_CONCURRENCY = 10_000
"""Maximum number of queries that wait at one server."""


class ServerRestarted(Exception):
    """The server lost the policy's state of an episode. The episode can be played again."""


class Server:
    """Holds policies, each loaded at its first query. `start_servers` makes Ray actors of it."""

    def __init__(self, sources: Mapping[str, PolicySource], inference: Inference) -> None:
        self._sources, self._inference = sources, inference
        self._thread = ThreadPoolExecutor(1)  # policies are not thread-safe
        self._policies: dict[str, tuple[Policy, Batcher[Query, Decision]]] = {}
        self._known: set[tuple[str, str]] = set()
        """Policy name and episode id of the active episodes."""

    @ray.method(max_task_retries=-1)
    async def reset(self, name: str, episodes: Sequence[Episode]) -> None:
        """Start these episodes. Ray repeats the call if the server dies and is restarted."""
        await self._in_turn(self._policy(name)[0].reset, episodes)
        self._known |= {(name, episode.id) for episode in episodes}

    async def act(self, name: str, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return the policy's answers.

        Raises:
            ServerRestarted: The server was restarted after the start of an episode.
        """
        if any((name, query.episode.id) not in self._known for query in queries):
            raise ServerRestarted("the policy's server died during the episode")
        return await self._policy(name)[1].ask(queries)

    async def finish(self, name: str, episodes: Sequence[Episode]) -> None:
        """Forget these episodes."""
        self._known -= {(name, episode.id) for episode in episodes}
        await self._in_turn(self._policy(name)[0].finish, episodes)

    async def time_single_query(self, name: str, query: Query) -> float:
        """Time of one warm query without batching (s)."""
        policy = self._policy(name)[0]
        policy.reset([query.episode])
        policy.act([query])
        start = time.perf_counter()
        for _ in range(TIMES):
            policy.act([query])
        return (time.perf_counter() - start) / TIMES

    async def pid(self) -> int:
        """Id of the server's process."""
        return os.getpid()

    async def batch_sizes(self) -> Mapping[str, Mapping[int, int]]:
        """Policy to batch size to number of batches."""
        return {name: dict(batcher.batches) for name, (_, batcher) in self._policies.items()}

    async def _in_turn(self, call: Callable[[Sequence[Episode]], None], episodes: Sequence[Episode]) -> None:
        await asyncio.get_running_loop().run_in_executor(self._thread, call, episodes)

    def _policy(self, name: str) -> tuple[Policy, Batcher[Query, Decision]]:
        if name not in self._policies:
            policy = build_policy(self._sources[name])
            inference = self._inference
            batcher = Batcher(policy.act, self._thread, max_batch=inference.batch, wait_s=inference.wait_ms / 1000)
            self._policies[name] = policy, batcher
        return self._policies[name]


class ServedPolicy:
    """A policy on a server. If the server dies, active episodes fail, because their state is lost."""

    def __init__(self, server: Any, name: str, spec: PolicySpec) -> None:
        self.spec = spec
        self._server, self._name = server, name
        self._ended: tuple[Sequence[Episode], Any] = ((), None)
        """The episodes that were ended last, and the call that makes the server forget them."""

    def load(self) -> None:
        """Wait until the server has loaded the policy."""
        ray.get(self._server.reset.remote(self._name, []))

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes."""
        ended, call = self._ended
        if any(episode in ended for episode in episodes):  # a second attempt, which a late call would end
            ray.wait([call])
        ray.get(self._server.reset.remote(self._name, list(episodes)))

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """Return the server's answers."""
        decisions: Sequence[Decision] = ray.get(self._server.act.remote(self._name, list(queries)))
        return decisions

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Forget these episodes, without waiting for the server."""
        self._ended = episodes, self._server.finish.remote(self._name, list(episodes))


def served_policies(server: Any, sources: Mapping[str, PolicySource]) -> dict[str, ServedPolicy]:
    """A server's policies by name."""
    local = {name: resolve_locally(source) for name, source in sources.items()}
    specs = {name: catalog.spec(source.kind, source.options) for name, source in local.items()}
    return {name: ServedPolicy(server, name, spec) for name, spec in specs.items() if _sees_images(spec)}


def _sees_images(spec: PolicySpec) -> bool:
    """Whether a policy observes images; only these are served."""
    return spec.sees is PolicyInput.OBSERVATION


def _image_policies(sources: Mapping[str, PolicySource]) -> list[str]:
    """Names of the policies that observe images; nothing of the user's code is imported here."""
    return [name for name, source in sources.items() if _sees_images(planned_spec(name, source))]


def start_servers(sources: Mapping[str, PolicySource], inference: Inference) -> list[Any]:
    """Start the suite's servers and return their handles. Ray restarts a server that dies."""
    chosen = {name: sources[name] for name in _image_policies(sources)}
    actor: Any = ray.remote(Server)
    options = {"num_cpus": 0, "num_gpus": inference.num_gpus, "max_restarts": -1, "max_concurrency": MAX_CONCURRENCY}
    threads = {name: os.environ.get(name, os.environ.get("OMP_NUM_THREADS", "1")) for name in ONE_THREAD}
    actor = actor.options(runtime_env=in_session({"env_vars": threads}), **options)
    return [actor.remote(chosen, inference) for _ in range(inference.replicas if chosen else 0)]


def choose_inference(
    sources: Mapping[str, PolicySource],
    cells: Sequence[Cell],
    inference: Inference,
    workers: int,
    log: Callable[[str], None],
) -> Literal["worker", "served"]:
    """Where the policies of a run compute: as the suite says, or for `auto` where answers are faster.

    Ray must be running. `workers` is the number of workers that query a server at the same time, `log` prints a line
    for the user.

    Raises:
        NoRoom: The suite requests more of a GPU than any node has.
        WorkerPoolError: A policy does not answer.
    """
    if inference.place == "worker":
        return "worker"
    check_room("inference", {"num_gpus": inference.num_gpus})
    if inference.place == "served":
        return "served"
    log("measuring where policies answer faster")
    times = measure_answer_times(sources, cells, inference, workers)
    if times is None:
        log("no policy observes images")
        return "worker"
    worker_s, served_s = times
    served = served_s < worker_s
    place = "in separate inference processes" if served else "in the workers"
    log(f"policies compute {place}: {1000 * worker_s:.1f} ms per answer in the worker, {1000 * served_s:.1f} ms served")
    return "served" if served else "worker"


def measure_answer_times(
    sources: Mapping[str, PolicySource], cells: Sequence[Cell], inference: Inference, workers: int
) -> tuple[float, float] | None:
    """Query each policy with black images, in one query and in one per worker at once; see `choose_inference`.

    Returns:
        Time that an episode waits for an answer in a worker, and for one from a server that all workers query at once
        (s, the means over policies). None if no policy observes images.

    Raises:
        WorkerPoolError: A policy does not answer.
    """
    servers = start_servers(sources, inference.model_copy(update={"replicas": 1}))
    if not servers:
        return None
    (server,) = servers
    queries = {cell.policy: _black_queries(cell, workers) for cell in reversed(cells)}
    single, batched = [], []
    try:
        for name in _image_policies(sources):
            single.append(answer(server.time_single_query.remote(name, queries[name][0])))
            answer(server.reset.remote(name, [query.episode for query in queries[name]]))
            for turn in range(1 + TIMES):
                start = time.perf_counter()
                for reference in [server.act.remote(name, [query]) for query in queries[name]]:
                    answer(reference)
                if turn:
                    batched.append(time.perf_counter() - start)
    except RayError as error:
        raise WorkerPoolError(f"a policy does not answer: {last_line(error)}") from error
    finally:
        ray.kill(server)
    return sum(single) / len(single), sum(batched) / len(batched)


def _black_queries(cell: Cell, count: int) -> list[Query]:
    spec = stand_in_spec(cell.task)
    observation = black_observation(cell.protocol.view, spec.body)
    return [Query(cell.episode(seed), 0, observation, action_spec=spec) for seed in range(count)]
