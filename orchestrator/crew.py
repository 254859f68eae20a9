"""The workers as the scheduler sees them. Ray's are in `ray_crew`; tests drive the scheduler with simulated ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from orchestrator.runner import Lease, Readiness
from results.record import EpisodeResult
from suites.vocabulary import Cell


class CrewError(Exception):
    """Something is wrong with all workers at once."""


class WorkerLost(Exception):
    """A worker has died, or talks nonsense; the message says why."""


@dataclass(frozen=True)
class Started:
    """A worker has been given a place: its process runs, and opens the first task."""


@dataclass(frozen=True)
class Unavailable:
    """The simulator cannot be opened here."""

    reason: str


@dataclass(frozen=True)
class Returned:
    """Episodes of the lease have come back, in order."""

    results: Sequence[EpisodeResult]
    memory_bytes: int
    """What the worker's process holds."""
    last: bool
    """Whether these are the last of the lease, and the worker is idle."""


Word = Started | Readiness | Unavailable | Returned


class Worker(Protocol):
    """One simulator process. It is starting, or plays a lease, or is idle; and says a word when there is one."""

    def play(self, lease: Lease) -> None:
        """Begin to play. Not before the worker has said that it is ready, nor while it plays."""

    def hear(self) -> Word:
        """What it has to say.

        Raises:
            WorkerLost: It cannot say anything any more.
        """


class Crew(Protocol):
    """Starts workers, listens to them, ends them."""

    def check(self) -> None:
        """Notice that what carries all workers has died.

        Raises:
            RayLost: It has.
        """

    def start(self, name: str, simulator: str, first: Cell) -> Worker:
        """Start a worker that opens the task of a cell first. Returns at once."""

    def wait(self, timeout_s: float) -> Sequence[Worker]:
        """Workers that have a word to say, as soon as there are any.

        Raises:
            CrewError: Nobody can be heard.
            RayLost: What carries them has died.
        """

    def end(self, worker: Worker) -> None:
        """End a worker, whatever it does."""

    def sweep(self) -> None:
        """Called several times a second: see to it that workers which were to end do end."""

    def close(self) -> None:
        """Wait until all that were to end have ended."""
