"""The remaining and the played seeds of each task of a collection. No Ray, no clock."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.policies.training.dataset_writer import Attempt, DatasetWriter
from robogauntlet.policies.training.lerobot_format import EncodedEpisode
from robogauntlet.results.record import Status
from robogauntlet.suites.episode import Cell
from robogauntlet.support.text import counted

MAX_LEASE = 4
"""Maximum number of episodes in a lease."""
UNMEASURED_S = 1.0
"""Expected duration of an episode before any has been measured."""
MAX_ATTEMPTS = 3
"""Number of workers that an episode may kill before it counts as an error."""
MAX_DEATHS_IN_A_ROW = 6
"""Number of workers that may die without a finished episode between them before the task is given up."""


@dataclass(frozen=True)
class PlayedSeed:
    """The result of playing one seed."""

    attempt: Attempt
    record: EncodedEpisode | None = None
    """Present if the attempt succeeded."""
    wall_s: float = 0.0

    @property
    def status(self) -> str:
        """`success`, `failure` or `error`."""
        return self.attempt.status

    @property
    def error(self) -> str | None:
        """Why the seed could not be played."""
        return self.attempt.error


class CollectionTask:
    """The seeds of one task, which are played in any order and committed in ascending order.

    Only as many seeds are leased as would complete the task if all succeeded. So the kept episodes are the first
    successes by seed, whatever the number and speed of workers.
    """

    def __init__(self, cell: Cell, episodes: int, first_seed: int, writer: DatasetWriter) -> None:
        """Collect `episodes` successes from `first_seed` on into a dataset, which may contain some already."""
        self.cell, self.episodes, self.writer = cell, episodes, writer
        self.reason: str | None = None
        """Why no more seeds are played although episodes are missing."""
        self._next = self._frontier = first_seed + len(writer.attempts)
        self._out: set[int] = set()
        self._lost: list[int] = []
        self._deaths: Counter[int] = Counter()
        self._deaths_in_a_row = 0
        self._early: dict[int, PlayedSeed] = {}
        self._counts = Counter(attempt.status for attempt in writer.attempts)

    @property
    def name(self) -> str:
        """`simulator/task`."""
        return self.cell.task

    @property
    def kept(self) -> int:
        """Successes so far."""
        return self._counts[Status.SUCCESS]

    @property
    def rejected(self) -> int:
        """Failures so far."""
        return self._counts[Status.FAILURE]

    @property
    def errors(self) -> int:
        """Episodes that could not be played so far."""
        return self._counts[Status.ERROR]

    @property
    def wanted(self) -> int:
        """Number of seeds that can be leased now."""
        return 0 if self.reason else max(0, self.episodes - self.kept - len(self._out))

    @property
    def open(self) -> bool:
        """Whether seeds are still to be played or to be returned."""
        return not self.reason and self.kept < self.episodes

    def lease(self, limit: int) -> tuple[int, ...]:
        """Take at most this many seeds to play."""
        seeds = []
        for _ in range(min(limit, self.wanted)):
            if self._lost:
                seeds.append(self._lost.pop(0))
            else:
                seeds.append(self._next)
                self._next += 1
        self._out.update(seeds)
        return tuple(seeds)

    def accept(self, played: PlayedSeed) -> None:
        """Record a played seed."""
        self._deaths_in_a_row = 0
        self._record(played)

    def _record(self, played: PlayedSeed) -> None:
        attempt = played.attempt
        self._out.discard(attempt.seed)
        self._counts[attempt.status] += 1
        self._early[attempt.seed] = played
        while self._frontier in self._early:
            ready = self._early.pop(self._frontier)
            self.writer.add(ready.attempt, ready.record)
            self._frontier += 1
        limit = 3 * self.episodes + 20
        if self.kept < self.episodes and self._counts.total() >= limit:
            latest = f"; latest error: {attempt.error}" if attempt.error else ""
            self.give_up(f"only {self.kept} of {counted(self._counts.total(), 'episode')} succeeded{latest}")

    def put_back(self, seeds: Sequence[int], reason: str) -> None:
        """Put back unfinished seeds of a dead worker; it died while playing the first."""
        self._out.difference_update(seeds)
        self._lost = sorted([*self._lost, *seeds])
        if seeds:
            self._deaths[seeds[0]] += 1
            if self._deaths[seeds[0]] >= MAX_ATTEMPTS:
                self._lost.remove(seeds[0])
                self._record(PlayedSeed(Attempt(seeds[0], Status.ERROR, 0, f"{reason}, {MAX_ATTEMPTS} times")))
        self._deaths_in_a_row += 1
        if self._deaths_in_a_row >= MAX_DEATHS_IN_A_ROW:
            self.give_up(f"{reason}, {MAX_DEATHS_IN_A_ROW} times in a row")

    def give_up(self, reason: str) -> None:
        """Lease no more seeds."""
        self.reason = self.reason or reason

    def flush_if_due(self) -> None:
        """Commit if much or old data is waiting or the task is complete; raises OSError, for example on a full disk."""
        if self.open:
            self.writer.flush_if_due()
        else:
            self.writer.flush()


class CollectionQueue:
    """The tasks of one simulator, as a `WorkSource` for the scheduler."""

    def __init__(self, tasks: Iterable[CollectionTask]) -> None:
        self._tasks = {task.name: task for task in tasks}
        self._active_leases = Counter[str]()
        self._played_s, self._played = 0.0, 0
        self.workers = 1

    @property
    def first(self) -> Cell:
        """The cell whose task a new worker opens first."""
        return self._choose(None).cell

    @property
    def waiting(self) -> int:
        """Episodes that can be leased now."""
        return sum(task.wanted for task in self._tasks.values())

    @property
    def waiting_s(self) -> float:
        """Expected time of these episodes for one worker."""
        return self.waiting * (self._played_s / self._played if self._played else UNMEASURED_S)

    def lease(self, open_task: str | None) -> Lease | None:
        """The next lease, small enough that the other workers get seeds of the task as well."""
        if not self.waiting:
            return None
        task = self._choose(open_task)
        self._active_leases[task.name] += 1
        return Lease(task.cell, task.lease(min(MAX_LEASE, math.ceil(task.wanted / self.workers))), message_s=0.0)

    def _choose(self, open_task: str | None) -> CollectionTask:
        """The open task if it has seeds left, else one that no worker plays, else the one with the most seeds left."""

        def preference(task: CollectionTask) -> tuple[bool, bool, bool, int]:
            return task.wanted > 0, task.name == open_task, not self._active_leases[task.name], task.wanted

        return max(self._tasks.values(), key=preference)

    def returned(self, lease: Lease, results: Sequence[PlayedSeed]) -> None:
        """Record played seeds and their durations."""
        for played in results:
            self._tasks[lease.cell.task].accept(played)
            self._played_s += played.wall_s
            self._played += 1

    def finished(self, lease: Lease) -> None:
        """All results of the lease have been returned."""
        self._active_leases[lease.cell.task] -= 1

    def lost(self, lease: Lease, seeds: Sequence[int], reason: str) -> Sequence[PlayedSeed]:
        """Put back unfinished seeds of a dead worker's lease. The task records a seed that is given up."""
        self._active_leases[lease.cell.task] -= 1
        self._tasks[lease.cell.task].put_back(seeds, reason)
        return ()

    def drop(self, task: str, reason: str) -> int:
        """Give up a task that cannot be opened; return the number of its missing episodes."""
        dropped = self._tasks[task]
        missing = dropped.episodes - dropped.kept if dropped.open else 0
        dropped.give_up(reason)
        return missing
