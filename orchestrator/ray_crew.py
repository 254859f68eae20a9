"""Workers that are Ray actors."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Mapping, Sequence
from typing import Any, cast

import ray
from ray.exceptions import RayActorError, RayError

from adapters import catalog
from orchestrator import crew
from orchestrator.cluster import RayLost, check_alive, check_room
from orchestrator.crew import CrewError, Returned, Started, Unavailable, WorkerLost
from orchestrator.environments.homes import Homes
from orchestrator.runner import Lease, Readiness
from orchestrator.sources import PolicySource
from orchestrator.worker import start_worker
from suites.placement import Resources
from suites.vocabulary import Cell

KILL_AFTER_S = 2.0
"""Time that Ray has to end a worker's process before it is killed."""


class RayWorker:
    """A Ray actor and what is awaited of it."""

    def __init__(self, actor: Any, first: Cell) -> None:
        """Args: actor: has just been started; first: what it opens first."""
        self.actor, self._first = actor, first
        self.pid: int | None = None
        self.node = ""
        self.pending: Any = actor.hello.remote()
        """The reference (starting, preparing) or generator (playing) that is awaited, or None when idle."""
        self._playing = False

    def play(self, lease: Lease) -> None:
        """See `crew.Worker`."""
        self.pending, self._playing = self.actor.play.remote(lease), True

    def hear(self) -> crew.Word:
        """See `crew.Worker`."""
        try:
            return self._word()
        except RayActorError:
            raise WorkerLost("the worker process died") from None
        except RayError as error:  # whatever befell it: no memory, no disk, a message that cannot be read
            raise WorkerLost(str(error).strip().splitlines()[0]) from None

    def _word(self) -> crew.Word:
        if self._playing:
            try:
                returned = Returned(*ray.get(next(self.pending)))
            except StopIteration:
                raise WorkerLost("the worker ended a lease before its last episode") from None
            if returned.last:
                self.pending, self._playing = None, False
            return returned
        if self.pid is None:
            self.pid, self.node = ray.get(self.pending)
            self.pending = self.actor.prepare.remote(self._first.task, self._first.protocol.view)
            return Started()
        answer: Readiness | str = ray.get(self.pending)
        self.pending = None
        return Unavailable(answer) if isinstance(answer, str) else answer


class RayCrew:
    """The crew on the Ray that is running."""

    def __init__(
        self,
        sources: Mapping[str, PolicySource],
        resources: Mapping[str, Resources] | None = None,
        servers: Sequence[Any] = (),
        homes: Homes | None = None,
    ) -> None:
        """Prepare to start workers.

        Args:
            sources: Policy name to what it is built from.
            resources: Simulator to what each of its workers needs.
            servers: Answer for the policies that look at images (`serving`), if there are any.
            homes: In which environment each simulator runs.

        Raises:
            NoRoom: No node has what a worker needs.
        """
        self._sources, self._resources, self._servers = sources, resources or {}, servers
        self._homes = homes or Homes()
        self._started = 0
        for simulator, asked in self._resources.items():
            check_room(f"resources.{simulator}", asked.for_ray())
        self._condemned: dict[int, float] = {}
        """Process id of an ended worker to the time at which it is killed if it still lives."""
        self._workers: dict[RayWorker, None] = {}
        """In the order in which they were started."""
        self._lost = False

    def check(self) -> None:
        """See `crew.Crew`."""
        try:
            check_alive()
        except RayLost:
            self._lost = True
            raise

    def start(self, name: str, simulator: str, first: Cell) -> RayWorker:
        """See `crew.Crew`."""
        with self._explained():
            asked = self._resources.get(simulator, Resources())
            server = self._servers[self._started % len(self._servers)] if self._servers else None
            self._started += 1
            actor = start_worker(name, self._homes.for_ray(catalog.find(simulator)), self._sources, asked, server)
            worker = RayWorker(actor, first)
        self._workers[worker] = None
        return worker

    def wait(self, timeout_s: float) -> Sequence[RayWorker]:
        """See `crew.Crew`."""
        by_pending = {id(worker.pending): worker for worker in self._workers if worker.pending is not None}
        pending = [worker.pending for worker in by_pending.values()]
        with self._explained():
            ready, _ = ray.wait(pending, num_returns=1, timeout=timeout_s, fetch_local=False)
            if ready and len(pending) > 1:
                ready, _ = ray.wait(pending, num_returns=len(pending), timeout=0, fetch_local=False)
        return [by_pending[id(item)] for item in ready]

    def end(self, worker: crew.Worker) -> None:
        """See `crew.Crew`. Ray's kill does not end a process that is stopped, so its id is remembered."""
        ended = cast(RayWorker, worker)
        self._workers.pop(ended, None)
        if not self._lost:  # else nobody is left to ask
            with contextlib.suppress(RayError, ValueError):
                ray.kill(ended.actor)
        if ended.pid is not None and ended.node == os.uname().nodename:
            self._condemned[ended.pid] = time.monotonic() + KILL_AFTER_S

    def sweep(self) -> None:
        """See `crew.Crew`."""
        for pid, deadline in list(self._condemned.items()):
            late = time.monotonic() - deadline
            try:
                os.kill(pid, signal.SIGKILL if late > 0 else 0)
            except (ProcessLookupError, PermissionError):
                del self._condemned[pid]
            else:
                if late > KILL_AFTER_S:
                    del self._condemned[pid]  # dead, and its parent has not taken notice

    def close(self) -> None:
        """See `crew.Crew`."""
        while self._condemned:
            self.sweep()
            time.sleep(0.02)

    @contextlib.contextmanager
    def _explained(self) -> Any:
        try:
            yield
        except RayError as error:
            self.check()
            raise CrewError(f"Ray: {str(error).strip().splitlines()[0]}") from error
