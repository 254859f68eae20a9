"""Policies in processes of their own, which answer the queries of all workers in batches."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import ray
from ray.exceptions import RayError

from adapters.contract import PROPRIOCEPTION_DIM, Observation
from orchestrator.batching import Batcher
from orchestrator.cluster import answer
from orchestrator.crew import CrewError
from orchestrator.sources import PolicySource, build, here
from policies import catalog
from policies.contract import Decision, Policy, PolicySpec, Query, Sees
from suites.placement import Inference
from suites.vocabulary import Cell, Episode

TIMES = 5
"""Queries over which a time is averaged."""
CONCURRENT = 10_000
"""Queries that may wait at one server."""


class ServerRestarted(Exception):
    """What a policy remembered of an episode is lost. The episode can be played again."""


class Server:
    """Holds policies, each loaded when it is first asked for. A Ray actor: `start_servers`."""

    def __init__(self, sources: Mapping[str, PolicySource], inference: Inference) -> None:
        """Args: sources: policy name to what it is built from; inference: how to batch."""
        self._sources, self._inference = sources, inference
        self._thread = ThreadPoolExecutor(1)  # policies are not made for several threads
        self._policies: dict[str, tuple[Policy, Batcher[Query, Decision]]] = {}
        self._known: set[tuple[str, str]] = set()
        """Policy and id of the episodes that are under way."""

    @ray.method(max_task_retries=-1)
    async def reset(self, name: str, episodes: Sequence[Episode]) -> None:
        """Start these episodes. A caller waits while a server that has died is started again."""
        await self._in_turn(self._policy(name)[0].reset, episodes)
        self._known |= {(name, episode.id) for episode in episodes}

    async def act(self, name: str, queries: Sequence[Query]) -> Sequence[Decision]:
        """The policy's answers.

        Raises:
            ServerRestarted: Not the server that started the episode.
        """
        if any((name, query.episode.id) not in self._known for query in queries):
            raise ServerRestarted("the policy's server died while the episode was under way")
        return await self._policy(name)[1].ask(queries)

    async def finish(self, name: str, episodes: Sequence[Episode]) -> None:
        """Forget these episodes."""
        self._known -= {(name, episode.id) for episode in episodes}
        await self._in_turn(self._policy(name)[0].finish, episodes)

    async def alone(self, name: str, query: Query) -> float:
        """Seconds that the policy takes for one query once warm, without any batching."""
        policy = self._policy(name)[0]
        policy.reset([query.episode])
        policy.act([query])
        start = time.perf_counter()
        for _ in range(TIMES):
            policy.act([query])
        return (time.perf_counter() - start) / TIMES

    async def pid(self) -> int:
        """Of its process."""
        return os.getpid()

    async def batch_sizes(self) -> Mapping[str, Mapping[int, int]]:
        """Policy to sizes of batches and how many there were of each."""
        return {name: dict(batcher.batches) for name, (_, batcher) in self._policies.items()}

    async def _in_turn(self, call: Callable[[Sequence[Episode]], None], episodes: Sequence[Episode]) -> None:
        await asyncio.get_running_loop().run_in_executor(self._thread, call, episodes)

    def _policy(self, name: str) -> tuple[Policy, Batcher[Query, Decision]]:
        if name not in self._policies:
            policy = build(self._sources[name])
            inference = self._inference
            batcher = Batcher(policy.act, self._thread, most=inference.batch, wait_s=inference.wait_ms / 1000)
            self._policies[name] = policy, batcher
        return self._policies[name]


class ServedPolicy:
    """A policy that a server runs. One that dies takes its episodes' state along, so an episode under way fails."""

    def __init__(self, server: Any, name: str, spec: PolicySpec) -> None:
        """Args: server: handle of the actor; name: of the policy there; spec: the policy's."""
        self.spec = spec
        self._server, self._name = server, name

    def reset(self, episodes: Sequence[Episode]) -> None:
        """Start these episodes."""
        ray.get(self._server.reset.remote(self._name, list(episodes)))

    def act(self, queries: Sequence[Query]) -> Sequence[Decision]:
        """The server's answers."""
        decisions: Sequence[Decision] = ray.get(self._server.act.remote(self._name, list(queries)))
        return decisions

    def finish(self, episodes: Sequence[Episode]) -> None:
        """Forget these episodes; does not wait for it."""
        self._server.finish.remote(self._name, list(episodes))


def served_policies(server: Any, sources: Mapping[str, PolicySource]) -> dict[str, Policy]:
    """A server's policies by name."""
    known = {name: here(source) for name, source in sources.items()}
    one = {name: known[name] for name in served(known)}
    return {name: ServedPolicy(server, name, catalog.spec(own.kind, own.options)) for name, own in one.items()}


def served(sources: Mapping[str, PolicySource]) -> list[str]:
    """Names of the policies that are worth serving: those that look at images."""
    return [name for name, one in sources.items() if catalog.spec(one.kind, one.options).sees is Sees.OBSERVATION]


def start_servers(sources: Mapping[str, PolicySource], inference: Inference) -> list[Any]:
    """Start the suite's servers; returns their handles at once. Ray starts one that dies again."""
    chosen = {name: sources[name] for name in served(sources)}
    actor: Any = ray.remote(Server)
    options = {"num_cpus": 0, "num_gpus": inference.num_gpus, "max_restarts": -1, "max_concurrency": CONCURRENT}
    environment = {"env_vars": {"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}}
    actor = actor.options(runtime_env=environment, **options)
    return [actor.remote(chosen, inference) for _ in range(inference.replicas if chosen else 0)]


@dataclass(frozen=True)
class AnswerTimes:
    """For how long an episode waits for an answer (s), the mean over policies."""

    worker_s: float
    """In a worker that answers its own queries."""
    served_s: float
    """From a server, with all workers asking at the same time."""

    @property
    def place(self) -> Literal["worker", "served"]:
        """Where the answer comes sooner."""
        return "served" if self.served_s < self.worker_s else "worker"

    def __str__(self) -> str:
        return f"{1000 * self.worker_s:.1f} ms an answer in the worker, {1000 * self.served_s:.1f} ms served"


def measure(
    sources: Mapping[str, PolicySource], cells: Sequence[Cell], inference: Inference, workers: int
) -> AnswerTimes | None:
    """Ask each policy about black images, alone and by so many workers at once. Ray must be running.

    Args:
        sources: Policies.
        cells: Of the run; the first of each policy says what it is asked.
        inference: How to serve.
        workers: That would ask a server at the same time.

    Returns:
        None if no policy looks at images.

    Raises:
        CrewError: One does not answer.
    """
    servers = start_servers(sources, inference.model_copy(update={"replicas": 1}))
    if not servers:
        return None
    (server,) = servers
    asked = {cell.policy: _black(cell, workers) for cell in reversed(cells)}
    alone, together = [], []
    try:
        for name in served(sources):
            alone.append(answer(server.alone.remote(name, asked[name][0])))
            answer(server.reset.remote(name, [one.episode for one in asked[name]]))
            for turn in range(1 + TIMES):
                start = time.perf_counter()
                for reference in [server.act.remote(name, [one]) for one in asked[name]]:
                    answer(reference)
                if turn:
                    together.append(time.perf_counter() - start)
    except RayError as error:
        raise CrewError(f"a policy does not answer: {str(error).strip().splitlines()[-1]}") from error
    finally:
        ray.kill(server)
    return AnswerTimes(sum(alone) / len(alone), sum(together) / len(together))


def _black(cell: Cell, count: int) -> list[Query]:
    view = cell.protocol.view
    images = {camera: np.zeros((view.image_size, view.image_size, 3), np.uint8) for camera in view.cameras}
    seen = Observation(images, np.zeros(PROPRIOCEPTION_DIM), "")
    return [Query(cell.episode(seed), 0, seen) for seed in range(count)]
