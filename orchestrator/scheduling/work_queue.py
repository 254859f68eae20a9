"""The scheduling policy: which worker plays which episodes next. Pure: no Ray, no clock, no files.

Opening a task takes seconds, so a worker keeps its open task while that has episodes left. Then it gets the task with
the most remaining work per worker; at the end of a run that is a task of other workers (work stealing). Work is
measured in seconds, by the durations of earlier episodes. Within a task, cells without a measured duration are played
first, then the cell with the most remaining work. Leases last about `LEASE_S` and shrink towards the end, so that
workers finish together. A lease and its results cost the scheduler almost a millisecond, so with many workers leases
are longer and messages rarer.
"""

from __future__ import annotations

import contextlib
from array import array
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np

from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.results.record import EpisodeResult
from robogauntlet.suites.episode import Cell

LEASE_S, LEASE_S_PER_WORKER = 2.0, 0.004
MESSAGE_S, MESSAGE_S_PER_WORKER = 0.1, 0.002
"""The minimum, and the time per worker that limits all workers together to 250 leases and 500 messages a second."""
UNMEASURED_S = 1.0
"""Expected duration of an episode before any has been measured."""
MAX_LEASE = 2000
_BEFORE_ALL_MEASURED = 1e15
START_S = 20.0
"""Expected time from the start of a worker to its first result, before any has been measured (s)."""


class Outcome(Protocol):
    """How an episode ended."""

    @property
    def status(self) -> str:
        """`success`, `failure` or `error`."""

    @property
    def error(self) -> str | None:
        """Why it could not be played."""


Result = TypeVar("Result", bound=Outcome)


class WorkSource(Protocol[Result]):
    """The remaining episodes of one simulator, as the scheduler sees them."""

    workers: int
    """Number of workers that share them; set by the scheduler."""

    @property
    def first(self) -> Cell:
        """The cell whose task a new worker opens first."""

    @property
    def waiting(self) -> int:
        """Episodes that can be leased now."""

    @property
    def waiting_s(self) -> float:
        """Expected time of these episodes for one worker."""

    def lease(self, open_task: str | None) -> Lease | None:
        """The next lease for a worker that has `open_task` open, or None if no episode is waiting."""

    def returned(self, lease: Lease, results: Sequence[Result]) -> None:
        """Accept results of a lease's episodes."""

    def finished(self, lease: Lease) -> None:
        """All results of the lease have been returned."""

    def lost(self, lease: Lease, seeds: Sequence[int], reason: str) -> Sequence[Result]:
        """Put back unfinished seeds of a dead worker's lease; return error results for the seeds that are given up."""

    def drop(self, task: str, reason: str) -> int:
        """Give up the episodes that need a task which cannot be opened; return their number."""


@dataclass
class _CellQueue:
    cell: Cell
    seeds: Sequence[int]
    index: int
    """Position among the cells of its task."""
    position: int = 0
    """Position of the next seed."""
    retries: deque[tuple[int, int]] = field(default_factory=deque)
    """(seed, attempts so far) of unfinished episodes of dead workers; they are played one by one."""
    mean_s: float | None = None

    @property
    def waiting(self) -> int:
        return len(self.seeds) - self.position + len(self.retries)

    @property
    def urgency(self) -> float:
        """Priority: the cell with the highest value is played next."""
        if self.retries:
            return 2 * _BEFORE_ALL_MEASURED
        if not self.waiting:
            return -1.0
        return self.waiting * self.mean_s if self.mean_s is not None else _BEFORE_ALL_MEASURED + self.waiting


class _TaskQueue:
    """The cells of one task, with sums that are kept up to date, so that choosing a task does not visit its cells."""

    def __init__(self) -> None:
        self.cells: list[_CellQueue] = []
        self.urgencies = array("d")
        self.waiting = 0
        self.unmeasured = 0
        """Waiting episodes of cells without a measured duration."""
        self.measured_s = 0.0
        """Expected time of the others."""
        self.active_leases = 0

    def add(self, cell: Cell, seeds: Sequence[int]) -> _CellQueue:
        queue = _CellQueue(cell, seeds, len(self.cells))
        self.cells.append(queue)
        self.urgencies.append(-1.0)
        self._count(queue, 1)
        return queue

    @contextlib.contextmanager
    def changing(self, queue: _CellQueue) -> Iterator[None]:
        """Keep the sums correct while a cell is changed inside the block."""
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
            self.urgencies[queue.index] = queue.urgency


class WorkQueue:
    """The remaining episodes of one simulator. The cost of an operation does not depend on their number."""

    def __init__(self, work: Iterable[tuple[Cell, Sequence[int]]], *, workers: int, max_attempts: int) -> None:
        """Create the queue of cells with their missing seeds; for `max_attempts` see `Suite`."""
        self._tasks: dict[str, _TaskQueue] = {}
        self._cells: dict[Cell, _CellQueue] = {}
        for cell, seeds in work:
            self._cells[cell] = self._tasks.setdefault(cell.task, _TaskQueue()).add(cell, seeds)
        self.workers = workers
        """Number of workers that share the queue."""
        self.waiting = sum(task.waiting for task in self._tasks.values())
        """Episodes that no worker holds."""
        self._max_attempts = max_attempts
        self._means = self._measured_cells = 0.0
        """Sum of the cells' mean durations, and number of cells that have one."""

    @property
    def first(self) -> Cell:
        """The cell whose task a new worker opens first."""
        return next(iter(self._cells))

    @property
    def waiting_s(self) -> float:
        """Expected time of these episodes for one worker."""
        return sum(map(self._expected_s, self._tasks.values()))

    def lease(self, open_task: str | None) -> Lease | None:
        """The next lease for a worker that has `open_task` open, or None if no episode is waiting."""
        task = self._choose_task(open_task)
        if task is None:
            return None
        queue = task.most_urgent()
        task.active_leases += 1
        size = self._size(queue)
        message_s = max(MESSAGE_S, MESSAGE_S_PER_WORKER * self.workers)
        with task.changing(queue):
            if queue.retries:
                seed, attempts = queue.retries.popleft()
                self.waiting -= 1
                return Lease(queue.cell, (seed,), attempts + 1, message_s)
            seeds = tuple(queue.seeds[queue.position : queue.position + size])
            queue.position += size
        self.waiting -= len(seeds)
        return Lease(queue.cell, seeds, message_s=message_s)

    def finished(self, lease: Lease) -> None:
        """All results of the lease have been returned."""
        self._tasks[lease.cell.task].active_leases -= 1

    def returned(self, lease: Lease, results: Sequence[EpisodeResult]) -> None:
        """Update the mean duration of the cell's episodes."""
        queue = self._cells[lease.cell]
        mean = sum(result.wall_s for result in results) / len(results)
        before = queue.mean_s
        with self._tasks[lease.cell.task].changing(queue):
            queue.mean_s = mean if before is None else 0.7 * before + 0.3 * mean
        self._means += queue.mean_s - (before or 0.0)
        self._measured_cells += before is None

    def lost(self, lease: Lease, seeds: Sequence[int], reason: str) -> list[EpisodeResult]:
        """Put back unfinished seeds of a dead worker's lease; return error results for the seeds that are given up.

        Any episode of the lease may have killed the worker, so from now on each is leased alone. An episode that kills
        its worker `max_attempts` times when leased alone is recorded as an error.
        """
        task, queue = self._tasks[lease.cell.task], self._cells[lease.cell]
        task.active_leases -= 1
        given_up: list[EpisodeResult] = []
        for seed in seeds:
            attempts = lease.attempt if len(lease.seeds) == 1 else 0
            if attempts >= self._max_attempts:
                episode = lease.cell.episode(seed)
                error = f"WorkerDied: {reason} (attempts: {attempts})"
                given_up.append(EpisodeResult.failed_to_run(episode, error, attempts=attempts))
            else:
                with task.changing(queue):
                    queue.retries.append((seed, attempts))
                self.waiting += 1
        return given_up

    def drop(self, task: str, reason: str) -> int:
        """Drop all waiting episodes: if one task cannot be opened, the simulator does not work here."""
        dropped, self.waiting = self.waiting, 0
        for queue in self._cells.values():
            with self._tasks[queue.cell.task].changing(queue):
                queue.position = len(queue.seeds)
                queue.retries.clear()
        return dropped

    def _choose_task(self, open_task: str | None) -> _TaskQueue | None:
        opened = self._tasks.get(open_task or "")
        if opened is not None and opened.waiting:
            return opened
        waiting = (task for task in self._tasks.values() if task.waiting)
        return max(waiting, key=lambda task: self._expected_s(task) / (1 + task.active_leases), default=None)

    def _expected_s(self, task: _TaskQueue) -> float:
        """Expected time of a task's waiting episodes."""
        unknown = self._means / self._measured_cells if self._measured_cells else UNMEASURED_S
        return max(task.measured_s + task.unmeasured * unknown, 1e-6 if task.waiting else 0.0)

    def _size(self, queue: _CellQueue) -> int:
        """Episodes in the next lease: one until a duration is known, then some seconds' worth, fewer near the end."""
        lease_s = max(LEASE_S, LEASE_S_PER_WORKER * self.workers)
        unplayed = len(queue.seeds) - queue.position
        wanted = 1.0 if queue.mean_s is None else lease_s / max(queue.mean_s, 1e-6)
        fair = -(-self.waiting // (2 * self.workers))
        return int(min(max(1, min(wanted, fair, MAX_LEASE)), unplayed))


def work_queues(work: Iterable[tuple[Cell, Sequence[int]]], max_attempts: int) -> dict[str, WorkQueue]:
    """Simulator to the queue of its cells with their missing seeds."""
    by_simulator: dict[str, list[tuple[Cell, Sequence[int]]]] = {}
    for cell, seeds in work:
        if len(seeds):
            by_simulator.setdefault(cell.simulator, []).append((cell, seeds))
    return {name: WorkQueue(cells, workers=1, max_attempts=max_attempts) for name, cells in by_simulator.items()}


def next_simulator(backlogs: Mapping[str, tuple[float, int]], start_s: Mapping[str, float]) -> str | None:
    """The simulator that a free slot should serve, or None if another worker is not worthwhile.

    A simulator without any worker comes first, then the one with the most work left per worker. n workers finish work R
    in R / n; with another one, which starts in s, they finish in (R + s) / (n + 1). That is earlier if R / n exceeds s.

    Args:
        backlogs: Simulator to the expected time of the episodes that no worker holds (s), and to the number of its
            workers that play or are starting.
        start_s: Simulator to the measured time from the start of a worker to its first result (s).
    """
    priorities = {
        name: (not workers, waiting_s / (1 + workers))
        for name, (waiting_s, workers) in backlogs.items()
        if waiting_s > 0 and (not workers or waiting_s / workers > start_s.get(name, START_S))
    }
    return max(priorities, key=lambda name: priorities[name], default=None)
