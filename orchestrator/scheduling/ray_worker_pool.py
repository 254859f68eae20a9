"""A worker pool of Ray actors."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Mapping, Sequence
from typing import Any, cast

import ray
from ray.exceptions import RayActorError, RayError, RayTaskError

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import AdapterError
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner, Job
from robogauntlet.orchestrator.episodes.lease import Lease, Readiness
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.ray_runtime.cluster import PROBE_S, Placement, placed_on
from robogauntlet.orchestrator.ray_runtime.session import (
    RayLost,
    check_alive,
    check_room,
    free_resources,
    in_session,
    workers_that_fit,
)
from robogauntlet.orchestrator.scheduling import worker_pool
from robogauntlet.orchestrator.scheduling.ray_worker import Worker
from robogauntlet.policies.contract import PolicyError
from robogauntlet.suites.episode import Cell
from robogauntlet.suites.resources import Resources
from robogauntlet.support.errors import first_line

KILL_AFTER_S = 2.0
"""Time after which the process of an ended worker is killed."""


class RayWorker:
    """A Ray actor that has just been started, and the reply that is pending."""

    def __init__(self, actor: Any, simulator: str, nodes: frozenset[str], first: Cell) -> None:
        self.actor, self._first = actor, first
        self.simulator, self.nodes = simulator, nodes
        self.pid: int | None = None
        self.node = ""
        self.pending: Any = actor.identify.remote()
        """The object reference (starting, preparing) or generator (playing) to wait for; None when idle."""
        self._playing = False

    def play(self, lease: Lease) -> None:
        """Send the lease to the actor."""
        self.pending, self._playing = self.actor.play.remote(lease), True

    def next_event(self) -> worker_pool.WorkerEvent:
        """Return the worker's next event; raises WorkerLost."""
        try:
            return self._read_event()
        except RayActorError:
            raise worker_pool.WorkerLost("the worker process died") from None
        except RayError as error:  # no memory, a full disk, an unreadable message, an exception of the job
            if isinstance(error, RayTaskError) and isinstance(error.cause, (AdapterError, PolicyError)):
                return worker_pool.Unavailable(first_line(error.cause))
            raise worker_pool.WorkerLost(first_line(error)) from None

    def _read_event(self) -> worker_pool.WorkerEvent:
        if self._playing:
            try:
                returned = worker_pool.EpisodesFinished(*ray.get(next(self.pending)))
            except StopIteration:
                raise worker_pool.WorkerLost("the worker ended a lease before its last episode") from None
            if returned.last:
                self.pending, self._playing = None, False
            return returned
        if self.pid is None:
            self.pid, self.node = ray.get(self.pending)
            self.pending = self.actor.prepare.remote(self._first.task, self._first.protocol.view)
            return worker_pool.Started()
        answer: Readiness | worker_pool.Unavailable = ray.get(self.pending)
        self.pending = None
        return answer


class RayWorkerPool:
    """Workers on the Ray cluster that is running."""

    def __init__(
        self,
        sources: Mapping[str, PolicySource],
        resources: Mapping[str, Resources] | None = None,
        servers: Sequence[Any] = (),
        environments: EnvironmentResolver | None = None,
        job: Job = EpisodeRunner.play,
    ) -> None:
        """Prepare to start workers.

        Args:
            sources: Policies by name.
            resources: Simulator to the resources of each of its workers.
            servers: Policy servers for the policies that observe images, if any.
            environments: The environment of each simulator.
            job: What the workers do with their leases.

        Raises:
            NoRoom: No node has the resources of a worker.
        """
        self._sources, self._resources, self._servers = sources, resources or {}, servers
        self._environments, self._job = environments or EnvironmentResolver(), job
        self._placement = Placement(self._environments)
        self._own_node = ray.get_runtime_context().get_node_id()
        self._started = 0
        for simulator, options in self._resources.items():
            check_room(f"resources.{simulator}", options.ray_options())
        self._terminating: dict[int, float] = {}
        """Process id of an ended worker to the time at which it is killed if it still runs."""
        self._workers: dict[RayWorker, None] = {}
        """In the order of their start."""
        self._lost = False

    def check(self, *, after_s: float = PROBE_S) -> None:
        """Raise RayLost if Ray itself has died; see `check_alive`."""
        try:
            check_alive(after_s=after_s)
        except RayLost:
            self._lost = True
            raise

    def start(self, name: str, simulator: str, first: Cell) -> RayWorker:
        """Start an actor. Returns immediately."""
        self.check(after_s=0.0)
        with self._pool_errors():
            description = catalog.find(simulator)
            nodes = self._placement.nodes(description)
            options = {**self._resources.get(simulator, Resources()).ray_options(), **placed_on(nodes)}
            environment = in_session(self._environments.ray_runtime_env(description))
            server = self._servers[self._started % len(self._servers)] if self._servers else None
            self._started += 1
            actor: Any = Worker
            actor = actor.options(max_restarts=0, max_task_retries=0, runtime_env=environment, **options)
            handle = actor.remote(name, dict(self._sources), self._job, server)
            worker = RayWorker(handle, simulator, nodes, first)
        self._workers[worker] = None
        return worker

    def room(self, simulator: str) -> int:
        """Number of further workers of a simulator for which nodes with it have free resources."""
        self.check(after_s=0.0)
        options = self._resources.get(simulator, Resources()).ray_options()
        with self._pool_errors():
            able, free = self._placement.able(catalog.find(simulator)), free_resources()
        return sum(workers_that_fit(free.get(node, {}), options) for node in able)

    def placeable_elsewhere(self, workers: Sequence[worker_pool.Worker]) -> Sequence[RayWorker]:
        """Those that could be placed on other nodes if they were started now, since nodes joined or left."""
        self.check(after_s=0.0)
        ray_workers = [cast(RayWorker, worker) for worker in workers]
        simulators = {worker.simulator for worker in ray_workers}
        with self._pool_errors():
            now = {simulator: self._placement.nodes(catalog.find(simulator)) for simulator in simulators}

        def elsewhere(worker: RayWorker) -> bool:
            nodes = now[worker.simulator]
            return bool(nodes - worker.nodes) or bool(worker.nodes and not nodes)

        return [worker for worker in ray_workers if elsewhere(worker)]

    def wait(self, timeout_s: float) -> Sequence[RayWorker]:
        """Return the workers that have an event."""
        by_pending = {id(worker.pending): worker for worker in self._workers if worker.pending is not None}
        pending = [worker.pending for worker in by_pending.values()]
        with self._pool_errors():
            ready, _ = ray.wait(pending, num_returns=1, timeout=timeout_s, fetch_local=False)
            if ready and len(pending) > 1:
                ready, _ = ray.wait(pending, num_returns=len(pending), timeout=0, fetch_local=False)
        return [by_pending[id(item)] for item in ready]

    def end(self, worker: worker_pool.Worker) -> None:
        """End a worker. Ray does not kill a stopped process, so `reap` kills it by its id."""
        ray_worker = cast(RayWorker, worker)
        self._workers.pop(ray_worker, None)
        if not self._lost:  # a dead Ray would not answer
            with contextlib.suppress(RayError, ValueError):
                ray.kill(ray_worker.actor)
        if ray_worker.pid is not None and ray_worker.node == self._own_node:
            self._terminating[ray_worker.pid] = time.monotonic() + KILL_AFTER_S

    def reap(self) -> None:
        """Kill ended workers whose processes still run after `KILL_AFTER_S`."""
        for pid, deadline in list(self._terminating.items()):
            late = time.monotonic() - deadline
            try:
                os.kill(pid, signal.SIGKILL if late > 0 else 0)
            except (ProcessLookupError, PermissionError):
                del self._terminating[pid]
            else:
                if late > KILL_AFTER_S:
                    del self._terminating[pid]  # a zombie: its parent has not waited for it

    def close(self) -> None:
        """Wait until the processes of all ended workers have exited."""
        while self._terminating:
            self.reap()
            time.sleep(0.02)

    @contextlib.contextmanager
    def _pool_errors(self) -> Any:
        try:
            yield
        except RayError as error:
            self.check()
            raise worker_pool.WorkerPoolError(f"Ray: {first_line(error)}") from error
