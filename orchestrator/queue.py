"""The scheduling policy: who plays what next. Pure: no Ray, no clock, no files.

Workers keep one task open, because building an environment costs seconds. So a worker is given more of its open task
as long as there is some, then the task with the most work left per worker on it; at the end of a run that is a task
on which others still work (stealing). Work is counted in seconds, by what its episodes took so far; a cell of which
none came back is begun first, then the one that will take longest. Episodes are handed out in leases that last about
`LEASE_S`, shrinking towards the end so that workers finish together. Handing one out and hearing its results takes the
scheduler most of a millisecond, so the more workers there are, the longer are leases and the rarer messages.
"""

from __future__ import annotations

import contextlib
from array import array
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from orchestrator.runner import Lease
from results.record import EpisodeResult
from suites.vocabulary import Cell

LEASE_S, LEASE_S_PER_WORKER = 2.0, 0.004
MESSAGE_S, MESSAGE_S_PER_WORKER = 0.1, 0.002
"""At least the first; of many workers, so much for each: 250 leases and 500 messages a second from all together."""
UNMEASURED_S = 1.0
"""What an episode is expected to take until any has come back."""
MAX_LEASE = 2000
_BEFORE_ALL_MEASURED = 1e15


@dataclass
class _CellQueue:
    cell: Cell
    seeds: Sequence[int]
    place: int
    """Among the cells of its task."""
    position: int = 0
    alone: deque[tuple[int, int]] = field(default_factory=deque)
    """(seed, attempts so far) of episodes that were under way when a worker died: played one by one."""
    mean_s: float | None = None

    @property
    def waiting(self) -> int:
        return len(self.seeds) - self.position + len(self.alone)

    @property
    def urgency(self) -> float:
        """The cell with the most is played next."""
        if self.alone:
            return 2 * _BEFORE_ALL_MEASURED
        if not self.waiting:
            return -1.0
        return self.waiting * self.mean_s if self.mean_s is not None else _BEFORE_ALL_MEASURED + self.waiting


class _TaskQueue:
    """The cells of one task, with sums over them that every change keeps, so that a choice costs no walk over cells."""

    def __init__(self) -> None:
        self.cells: list[_CellQueue] = []
        self.urgencies = array("d")
        self.waiting = 0
        self.unmeasured = 0
        """Waiting episodes of cells of which none has come back."""
        self.measured_s = 0.0
        """Expected time of the others."""
        self.under_way = 0
        """Leases that workers hold."""

    def add(self, cell: Cell, seeds: Sequence[int]) -> _CellQueue:
        queue = _CellQueue(cell, seeds, len(self.cells))
        self.cells.append(queue)
        self.urgencies.append(-1.0)
        self._count(queue, 1)
        return queue

    @contextlib.contextmanager
    def changing(self, queue: _CellQueue) -> Iterator[None]:
        """Whatever changes in a cell, changes in here."""
        self._count(queue, -1)
        try:
            yield
        finally:
            self._count(queue, 1)

    def most_urgent(self) -> _CellQueue:
        return self.cells[int(np.argmax(np.frombuffer(self.urgencies)))]

    def _count(self, queue: _CellQueue, sign: int) -> None:
        waiting = queue.waiting
        self.waiting += sign * waiting
        if queue.mean_s is None:
            self.unmeasured += sign * waiting
        else:
            self.measured_s += sign * waiting * queue.mean_s
        if sign > 0:
            self.urgencies[queue.place] = queue.urgency


class WorkQueue:
    """The episodes of one simulator that are still to be played. What it does costs the same however many they are."""

    def __init__(
        self, work: Iterable[tuple[Cell, Sequence[int]]], *, workers: int, max_attempts: int, at_once: int = 1
    ) -> None:
        """Take up work.

        Args:
            work: Cells with their missing seeds.
            workers: How many share it.
            max_attempts: See `Suite`.
            at_once: Episodes that a worker plays at once.
        """
        self._tasks: dict[str, _TaskQueue] = {}
        self._cells: dict[Cell, _CellQueue] = {}
        for cell, seeds in work:
            self._cells[cell] = self._tasks.setdefault(cell.task, _TaskQueue()).add(cell, seeds)
        self.workers = workers
        """How many share it; may change."""
        self.waiting = sum(task.waiting for task in self._tasks.values())
        """Episodes that no worker holds."""
        self._max_attempts, self._at_once = max_attempts, at_once
        self._means = self._measured_cells = 0.0
        """Sum of the cells' mean durations, and number of cells that have one."""

    @property
    def waiting_s(self) -> float:
        """Time that these episodes are expected to take one worker."""
        return sum(map(self._expected_s, self._tasks.values()))

    def lease(self, open_task: str | None) -> Lease | None:
        """The next lease for a worker that has `open_task` open, or None if nothing waits."""
        task = self._choose_task(open_task)
        if task is None:
            return None
        queue = task.most_urgent()
        task.under_way += 1
        size = self._size(queue)
        message_s = max(MESSAGE_S, MESSAGE_S_PER_WORKER * self.workers)
        with task.changing(queue):
            if queue.alone:
                seed, attempts = queue.alone.popleft()
                self.waiting -= 1
                return Lease(queue.cell, (seed,), attempts + 1, message_s)
            seeds = tuple(queue.seeds[queue.position : queue.position + size])
            queue.position += size
        self.waiting -= len(seeds)
        return Lease(queue.cell, seeds, message_s=message_s)

    def finished(self, lease: Lease) -> None:
        """All of the lease's episodes have come back."""
        self._tasks[lease.cell.task].under_way -= 1

    def measured(self, cell: Cell, results: Sequence[EpisodeResult]) -> None:
        """Learn from results how long this cell's episodes take."""
        queue = self._cells[cell]
        mean = sum(result.wall_s for result in results) / len(results)
        before = queue.mean_s
        with self._tasks[cell.task].changing(queue):
            queue.mean_s = mean if before is None else 0.7 * before + 0.3 * mean
        self._means += queue.mean_s - (before or 0.0)
        self._measured_cells += before is None

    def lost(self, lease: Lease, seeds: Sequence[int], reason: str) -> list[EpisodeResult]:
        """A worker died holding these seeds of its lease. Puts them back, or gives them up.

        A lease of several episodes does not tell which one is to blame, so each is played alone from then on; one that
        ends its worker alone `max_attempts` times is recorded as an error.

        Args:
            lease: What the worker held.
            seeds: The lease's seeds that have not come back.
            reason: What happened, for the record.

        Returns:
            Records of the episodes that are given up.
        """
        task, queue = self._tasks[lease.cell.task], self._cells[lease.cell]
        task.under_way -= 1
        given_up: list[EpisodeResult] = []
        was_alone = len(lease.seeds) == 1
        for seed in seeds:
            attempts = lease.attempt if was_alone else 0
            if attempts >= self._max_attempts:
                episode = lease.cell.episode(seed)
                error = f"WorkerDied: {reason} (attempts: {attempts})"
                given_up.append(EpisodeResult.failed_to_run(episode, error, attempts=attempts))
            else:
                with task.changing(queue):
                    queue.alone.append((seed, attempts))
                self.waiting += 1
        return given_up

    def drop(self) -> int:
        """Forget everything that waits; return how many episodes that was."""
        dropped, self.waiting = self.waiting, 0
        for queue in self._cells.values():
            with self._tasks[queue.cell.task].changing(queue):
                queue.position = len(queue.seeds)
                queue.alone.clear()
        return dropped

    def _choose_task(self, open_task: str | None) -> _TaskQueue | None:
        opened = self._tasks.get(open_task or "")
        if opened is not None and opened.waiting:
            return opened
        waiting = (task for task in self._tasks.values() if task.waiting)
        return max(waiting, key=lambda task: self._expected_s(task) / (1 + task.under_way), default=None)

    def _expected_s(self, task: _TaskQueue) -> float:
        """Time that a task's waiting episodes are expected to take."""
        unknown = self._means / self._measured_cells if self._measured_cells else UNMEASURED_S
        return max(task.measured_s + task.unmeasured * unknown, 1e-6 if task.waiting else 0.0)

    def _size(self, queue: _CellQueue) -> int:
        """Episodes to hand out: one until a duration is known, then some seconds' worth, fewer near the end.

        A worker that plays several at once is given so many at least.
        """
        lease_s = max(LEASE_S, LEASE_S_PER_WORKER * self.workers)
        unplayed = len(queue.seeds) - queue.position
        wanted = 1.0 if queue.mean_s is None else lease_s / max(queue.mean_s, 1e-6)
        fair = -(-self.waiting // (2 * self.workers))
        return int(min(max(self._at_once, min(wanted, fair, MAX_LEASE)), unplayed))
