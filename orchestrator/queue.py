"""The scheduling policy: who plays what next. Pure: no Ray, no clock, no files.

Workers keep one task open, because building an environment costs seconds. So a worker is given more of its open task
as long as there is some, then the task with the most work left per worker on it; at the end of a run that is a task
on which others still work (stealing). Work is counted in seconds, by what its episodes took so far; a cell of which
none came back is begun first, then the one that will take longest. Episodes are handed out in leases that last about
`LEASE_S`, shrinking towards the end so that workers finish together.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from orchestrator.runner import Lease
from results.record import EpisodeResult
from suites.vocabulary import Cell

LEASE_S = 2.0
UNMEASURED_S = 1.0
"""What an episode is expected to take until any has come back."""
MAX_LEASE = 2000


@dataclass
class _CellQueue:
    cell: Cell
    seeds: Sequence[int]
    position: int = 0
    alone: deque[tuple[int, int]] = field(default_factory=deque)
    """(seed, attempts so far) of episodes that were under way when a worker died: played one by one."""
    mean_s: float | None = None

    @property
    def waiting(self) -> int:
        return len(self.seeds) - self.position + len(self.alone)


class WorkQueue:
    """The episodes of one simulator that are still to be played."""

    def __init__(self, work: Iterable[tuple[Cell, Sequence[int]]], *, workers: int, max_attempts: int) -> None:
        """Args: work: cells with their missing seeds; workers: how many share it; max_attempts: see `Suite`."""
        self._by_task: dict[str, list[_CellQueue]] = {}
        self._of: dict[Cell, _CellQueue] = {}
        for cell, seeds in work:
            queue = _CellQueue(cell, seeds)
            self._by_task.setdefault(cell.task, []).append(queue)
            self._of[cell] = queue
        self.workers = workers
        """How many share it; may change."""
        self._max_attempts = max_attempts
        self._under_way: Counter[str] = Counter()

    @property
    def waiting(self) -> int:
        """Episodes that no worker holds."""
        return sum(queue.waiting for queues in self._by_task.values() for queue in queues)

    @property
    def waiting_s(self) -> float:
        """Time that these episodes are expected to take one worker."""
        return sum(self._expected_s().values())

    def lease(self, open_task: str | None) -> Lease | None:
        """The next lease for a worker that has `open_task` open, or None if nothing waits."""
        task = self._choose_task(open_task)
        if task is None:
            return None
        queue = max(
            self._by_task[task],
            key=lambda q: (bool(q.alone), q.mean_s is None, q.waiting * (q.mean_s or UNMEASURED_S)),
        )
        self._under_way[task] += 1
        if queue.alone:
            seed, attempts = queue.alone.popleft()
            return Lease(queue.cell, (seed,), attempts + 1)
        size = self._size(queue)
        seeds = tuple(queue.seeds[queue.position : queue.position + size])
        queue.position += size
        return Lease(queue.cell, seeds)

    def finished(self, lease: Lease) -> None:
        """All of the lease's episodes have come back."""
        self._under_way[lease.cell.task] -= 1

    def measured(self, cell: Cell, results: Sequence[EpisodeResult]) -> None:
        """Learn from results how long this cell's episodes take."""
        queue = self._of[cell]
        mean = sum(result.wall_s for result in results) / len(results)
        queue.mean_s = mean if queue.mean_s is None else 0.7 * queue.mean_s + 0.3 * mean

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
        self._under_way[lease.cell.task] -= 1
        given_up: list[EpisodeResult] = []
        was_alone = len(lease.seeds) == 1
        for seed in seeds:
            attempts = lease.attempt if was_alone else 0
            if attempts >= self._max_attempts:
                episode = lease.cell.episode(seed)
                error = f"WorkerDied: {reason} (attempts: {attempts})"
                given_up.append(EpisodeResult.failed_to_run(episode, error, attempts=attempts))
            else:
                self._of[lease.cell].alone.append((seed, attempts))
        return given_up

    def drop(self) -> int:
        """Forget everything that waits; return how many episodes that was."""
        dropped = self.waiting
        for queues in self._by_task.values():
            for queue in queues:
                queue.position = len(queue.seeds)
                queue.alone.clear()
        return dropped

    def _choose_task(self, open_task: str | None) -> str | None:
        if open_task is not None and any(queue.waiting for queue in self._by_task.get(open_task, ())):
            return open_task
        expected = self._expected_s()
        return max(expected, key=lambda task: expected[task] / (1 + self._under_way[task]), default=None)

    def _expected_s(self) -> Mapping[str, float]:
        """Task that has episodes waiting to the time that they are expected to take."""
        known = [queue.mean_s for queues in self._by_task.values() for queue in queues if queue.mean_s is not None]
        unknown = sum(known) / len(known) if known else UNMEASURED_S
        expected = {
            task: sum(queue.waiting * (unknown if queue.mean_s is None else queue.mean_s) for queue in queues)
            for task, queues in self._by_task.items()
            if any(queue.waiting for queue in queues)
        }
        return {task: max(seconds, 1e-6) for task, seconds in expected.items()}

    def _size(self, queue: _CellQueue) -> int:
        """Episodes to hand out at once: one until a duration is known, then `LEASE_S` worth, fewer near the end."""
        unplayed = len(queue.seeds) - queue.position
        wanted = 1.0 if queue.mean_s is None else LEASE_S / max(queue.mean_s, 1e-6)
        fair = -(-self.waiting // (2 * self.workers))
        return int(max(1, min(wanted, fair, unplayed, MAX_LEASE)))
