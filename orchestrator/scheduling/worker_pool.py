"""The interface between the scheduler and its workers. Ray implements it in `ray_worker_pool`, tests simulate it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from robogauntlet.orchestrator.episodes.lease import Lease, Readiness
from robogauntlet.suites.episode import Cell


class WorkerPoolError(Exception):
    """A failure of the pool itself, not of a single worker."""


class WorkerLost(Exception):
    """The worker died or sent an invalid message; the exception's text gives the reason."""


@dataclass(frozen=True)
class Started:
    """The worker's process runs and opens its first task."""


@dataclass(frozen=True)
class Unavailable:
    """The worker cannot open its first task or the task of its lease."""

    reason: str


@dataclass(frozen=True)
class EpisodesFinished:
    """Results of episodes of the lease, in order; none once the worker has loaded the lease's policy."""

    results: Sequence[Any]
    """What the workers' job yields for each episode, such as an `EpisodeResult`."""
    memory_bytes: int
    """Memory of the worker's process."""
    last: bool
    """Whether the lease is complete, so that the worker is idle."""


WorkerEvent = Started | Readiness | Unavailable | EpisodesFinished


class Worker(Protocol):
    """One simulator process, which is starting, playing a lease, or idle."""

    def play(self, lease: Lease) -> None:
        """Start to play. The worker must be ready and idle."""

    def next_event(self) -> WorkerEvent:
        """Return the worker's next event; raises WorkerLost."""


class WorkerPool(Protocol):
    """Starts and ends workers, and waits for their events."""

    def check(self) -> None:
        """Raise RayLost if Ray itself has died."""

    def start(self, name: str, simulator: str, first: Cell) -> Worker:
        """Start a worker that opens the cell's task first. Returns immediately."""

    def room(self, simulator: str) -> int:
        """Number of further workers of a simulator for which there is room now."""

    def placeable_elsewhere(self, workers: Sequence[Worker]) -> Sequence[Worker]:
        """Those that could be placed on other nodes if they were started now, since nodes joined or left."""

    def wait(self, timeout_s: float) -> Sequence[Worker]:
        """Return the workers that have an event, as soon as there are any.

        Raises:
            WorkerPoolError: Ray cannot wait for the workers.
            RayLost: Ray itself has died.
        """

    def end(self, worker: Worker) -> None:
        """End a worker, whatever it is doing."""

    def reap(self) -> None:
        """Kill ended workers whose processes still run. Called several times a second."""

    def close(self) -> None:
        """Wait until the processes of all ended workers have exited."""
