"""Counts the episodes of a run: the one account of how far it is, which all of its observers read."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from robogauntlet.orchestrator.runs.plan import Plan
from robogauntlet.results.live_status import LiveSimulator
from robogauntlet.results.record import EpisodeResult, Status
from robogauntlet.results.store.history_records import CellKey, Counts
from robogauntlet.suites.episode import Cell

WINDOW_S = 60.0
"""Time over which the pace is averaged (s)."""


@dataclass
class _Simulator:
    planned: int
    outcomes: Counter[str] = field(default_factory=Counter)
    ready_at: float | None = None
    recent: deque[tuple[float, int]] = field(default_factory=deque)
    """Times of returned rows, and how many."""
    played: int = 0
    """Episodes that were played now, not in an earlier part of the run."""
    seconds: float = 0.0
    """Sum of their durations (s)."""
    squares: float = 0.0
    """Sum of the squares of these (s²)."""
    opening_s: float = 0.0
    """Time in which tasks were opened and policies loaded."""
    tasks: set[str] = field(default_factory=set)
    """Those that were opened."""

    @property
    def left(self) -> int:
        """Episodes without a row."""
        return max(self.planned - self.outcomes.total(), 0)

    def cost(self) -> tuple[float, float]:
        """Bounds of the mean duration of its episodes (s), of which there are two or more."""
        mean = self.seconds / self.played
        variance = max(self.squares / self.played - mean**2, 0.0) / (self.played - 1)
        spread = 2 * math.sqrt(variance)
        return max(mean - spread, mean / 2), mean + spread

    def per_minute(self, now: float) -> float | None:
        """Episodes per minute over the last `WINDOW_S`."""
        while self.recent and now - self.recent[0][0] > WINDOW_S:
            self.recent.popleft()
        if self.ready_at is None or not self.recent:
            return None
        return sum(n for _, n in self.recent) / max(min(now - self.ready_at, WINDOW_S), 1.0) * 60.0


class RunProgress:
    """Counts the outcomes of each simulator, and of each policy under each condition, which are never pooled."""

    def __init__(self, plan: Plan, stored: Mapping[CellKey, Counts], now: Callable[[], float] = time.monotonic) -> None:
        """Begin with the counts of the stored rows; simulators that are unavailable here are left out."""
        self._now = now
        cells, seeds = Counter(cell.simulator for cell in plan.cells), plan.suite.seeds.count
        available = [name for name in plan.simulators if name not in plan.unavailable]
        self._simulators = {name: _Simulator(cells[name] * seeds) for name in available}
        self._tasks = {name: {cell.task for cell in plan.cells if cell.simulator == name} for name in available}
        self._busy: deque[tuple[float, float]] = deque()
        """Times of returned rows, and how long workers were busy with them (s)."""
        self._names = {cell.policy_digest: cell.policy for cell in reversed(plan.cells)}
        self._outcomes: Counter[tuple[str, str, int, str]] = Counter()
        self.policies = len(self._names)
        """Number of policies."""
        for (digest, task, axis, severity), counts in stored.items():
            simulator = self._simulators.get(task.partition("/")[0])
            found = {Status.SUCCESS: counts.successes, Status.FAILURE: counts.failures, Status.ERROR: counts.errors}
            for status, count in found.items():
                self._outcomes[digest, axis, severity, status] += count
                if simulator is not None:
                    simulator.outcomes[status] += count

    def replan(self, planned: Mapping[Cell, int]) -> None:
        """Set the number of planned episodes, by cell, if it grows from round to round."""
        for name, simulator in self._simulators.items():
            simulator.planned = sum(count for cell, count in planned.items() if cell.simulator == name)

    def started(self, simulator: str) -> bool:
        """Note that a worker has opened its simulator; return whether it is the first of that simulator."""
        progress = self._simulators[simulator]
        is_first = progress.ready_at is None
        if is_first:
            progress.ready_at = self._now()
        return is_first

    def count(self, rows: Sequence[EpisodeResult]) -> None:
        """Count returned rows."""
        now = self._now()
        self._outcomes.update((row.policy_digest, row.axis, row.severity, row.status) for row in rows)
        for (name, status), count in Counter((row.simulator, row.status) for row in rows).items():
            progress = self._simulators[name]
            progress.outcomes[status] += count
            progress.recent.append((now, count))
        for row in rows:
            progress = self._simulators[row.simulator]
            progress.played += 1
            progress.seconds += row.wall_s
            progress.squares += row.wall_s**2
            progress.opening_s += row.build_s + row.load_s
            progress.tasks.add(row.task)
            self._busy.append((now, row.wall_s + row.build_s + row.load_s))

    def simulators(self) -> tuple[LiveSimulator, ...]:
        """The progress of each simulator."""
        now = self._now()
        return tuple(_live(name, progress, progress.per_minute(now)) for name, progress in self._simulators.items())

    def left_s(self) -> tuple[float, float] | None:
        """The shortest and longest time in which the rest is expected to be played (s), None before that can be told.

        The work that is left, divided by the workers that were busy in the last minute. An episode of a simulator costs
        what its episodes have cost, give or take two standard errors of their mean; one of a simulator that has not
        begun, what the cheapest or the dearest of the others costs. The longest time has the opening of further tasks.
        """
        now = self._now()
        while self._busy and now - self._busy[0][0] > WINDOW_S:
            self._busy.popleft()
        begun = [one.ready_at for one in self._simulators.values() if one.ready_at is not None]
        known = {name: one.cost() for name, one in self._simulators.items() if one.played > 1}
        if not known or not begun or not self._busy:
            return None
        workers = sum(busy for _, busy in self._busy) / max(min(now - min(begun), WINDOW_S), 1.0)
        unknown = min(low for low, _ in known.values()), max(high for _, high in known.values())
        costs = [(one.left, *known.get(name, unknown)) for name, one in self._simulators.items()]
        opened = sum(len(one.tasks) for one in self._simulators.values())
        opening_s = sum(one.opening_s for one in self._simulators.values()) / max(opened, 1)
        unopened = sum(len(self._tasks[name] - one.tasks) for name, one in self._simulators.items() if one.left)
        low, high = (sum(cost[0] * cost[end] for cost in costs) / workers for end in (1, 2))
        return low, high + opening_s * unopened / workers

    def conditions(self) -> Iterator[tuple[str, str, int, Counts]]:
        """Yield each policy, axis and severity of which there are rows, with their counts."""
        for digest, axis, severity in dict.fromkeys(key[:3] for key in self._outcomes):
            if digest in self._names:
                found = (self._outcomes[digest, axis, severity, status] for status in Status)
                yield self._names[digest], axis, severity, Counts(0, *found)


def _live(name: str, progress: _Simulator, pace: float | None) -> LiveSimulator:
    return LiveSimulator(
        simulator=name,
        planned=progress.planned,
        successes=progress.outcomes[Status.SUCCESS],
        failures=progress.outcomes[Status.FAILURE],
        errors=progress.outcomes[Status.ERROR],
        per_minute=pace,
    )
