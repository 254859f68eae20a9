"""Shows the progress of a run."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

from rich.console import Console
from rich.progress_bar import ProgressBar
from rich.table import Table

from robogauntlet.orchestrator.episodes.lease import Readiness
from robogauntlet.orchestrator.live_display import Display
from robogauntlet.orchestrator.runs.plan import Plan
from robogauntlet.results.live_status import LiveSimulator
from robogauntlet.results.record import EpisodeResult, outcome_text
from robogauntlet.suites.episode import CLEAN, Cell, Condition
from robogauntlet.support.durations import format_duration
from robogauntlet.support.errors import first_line
from robogauntlet.support.text import counted

WINDOW_S = 60.0
"""Time over which the pace is averaged (s)."""


@dataclass
class _SimulatorProgress:
    planned: int
    success: int = 0
    failure: int = 0
    error: int = 0
    ready_at: float | None = None
    recent: deque[tuple[float, int]] = field(default_factory=deque)

    @property
    def done(self) -> int:
        return self.success + self.failure + self.error

    def per_minute(self, now: float) -> float | None:
        """Episodes per minute over the last `WINDOW_S`."""
        while self.recent and now - self.recent[0][0] > WINDOW_S:
            self.recent.popleft()
        if self.ready_at is None or not self.recent:
            return None
        return sum(n for _, n in self.recent) / max(min(now - self.ready_at, WINDOW_S), 1.0) * 60.0

    def left_s(self, now: float) -> float | None:
        """Expected remaining time (s)."""
        pace = self.per_minute(now)
        return (self.planned - self.done) / pace * 60.0 if pace else None


class Progress(Display):
    """A bar per simulator with the success so far of a single policy, episodes per minute and time left.

    If it is verbose, it also prints a line for each episode.
    """

    def __init__(self, console: Console, *, verbose: bool = False, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__(console, now=now)
        self._verbose = verbose
        self._simulators: dict[str, _SimulatorProgress] = {}
        self._policies = 0

    def begin(self, plan: Plan, counts: Mapping[tuple[str, str], int]) -> None:
        """Set up the bars, with the number of existing rows by (simulator, status)."""
        cells, seeds = Counter(cell.simulator for cell in plan.cells), plan.suite.seeds.count
        self._policies = len({cell.policy_digest for cell in plan.cells})
        available = [name for name in plan.simulators if name not in plan.unavailable]
        self._simulators = {name: _SimulatorProgress(cells[name] * seeds) for name in available}
        for (name, status), count in counts.items():
            if name in self._simulators:
                setattr(self._simulators[name], status, count)
        already = sum(counts.values())
        if already:
            self.log(f"continuing: {already:,} of {counted(plan.episodes, 'episode')} already done")

    def replan(self, planned: Mapping[Cell, int]) -> None:
        """Set the number of planned episodes, by cell, if it grows from round to round."""
        for name, progress in self._simulators.items():
            progress.planned = sum(count for cell, count in planned.items() if cell.simulator == name)

    def __exit__(self, *error: Any) -> None:
        self.draw(self._table, self._lines, at_once=True)
        super().__exit__(*error)

    def on_started(self, simulator: str, readiness: Readiness) -> None:
        """A worker has opened its simulator."""
        progress = self._simulators[simulator]
        if progress.ready_at is None:
            progress.ready_at = self._now()
            frame = f", {1000 * readiness.frame_s:.0f} ms per observation" if readiness.frame_s else ""
            self.log(f"{simulator}: ready (renders on {readiness.render_device}{frame})")

    def on_results(self, results: Sequence[EpisodeResult]) -> None:
        """Count returned rows."""
        now = self._now()
        for row in results if self._verbose else ():
            condition = "" if row.axis == CLEAN else f" under {Condition(row.axis, row.severity)}"
            reason = f": {first_line(row.error)}" if row.error else ""
            episode = f"{row.task}, {row.policy}{condition}, seed {row.seed}"
            outcome = outcome_text(row.status, row.failure)
            self.log(f"{episode}: {outcome} in {counted(row.steps, 'step')}, {row.wall_s:.2f} s{reason}")
        for (name, status), count in Counter((r.simulator, r.status) for r in results).items():
            progress = self._simulators[name]
            setattr(progress, status, getattr(progress, status) + count)
            progress.recent.append((now, count))

    def on_tick(self) -> None:
        """Update the display."""
        self.draw(self._table, lambda: self._lines(finished=False))

    def live(self) -> tuple[LiveSimulator, ...]:
        """The progress as data."""
        now = self._now()
        return tuple(
            LiveSimulator(
                simulator=name,
                planned=progress.planned,
                successes=progress.success,
                failures=progress.failure,
                errors=progress.error,
                per_minute=progress.per_minute(now),
                left_s=progress.left_s(now),
            )
            for name, progress in self._simulators.items()
        )

    def recording(self, count: int, end: float = math.inf) -> RecordingProgress:
        """A bar for the recording of this number of videos and snapshots; `end` is the latest end, by the clock."""
        return RecordingProgress(self._console, count, end=end, now=self._now)

    def _table(self) -> Table:
        table = Table.grid(padding=(0, 2))
        for name, progress in self._simulators.items():
            table.add_row(
                f"[bold]{name}",
                ProgressBar(total=max(progress.planned, 1), completed=progress.done, width=30),
                f"{progress.done}/{progress.planned}",
                *self._figures(progress),
            )
        return table

    def _lines(self, *, finished: bool = True) -> Iterator[str]:
        for name, progress in self._simulators.items():
            if progress.done >= progress.planned and not finished:
                continue
            yield "  ".join(filter(None, [f"{name}: {progress.done}/{progress.planned}", *self._figures(progress)]))

    def _figures(self, progress: _SimulatorProgress) -> list[str]:
        now = self._now()
        valid = progress.success + progress.failure
        pace, left = progress.per_minute(now), progress.left_s(now)
        return [
            # Several policies have no rate in common.
            f"success {100 * progress.success / valid:.0f} %" if valid and self._policies == 1 else "",
            f"{pace:.0f} episodes/min" if pace and progress.done < progress.planned else "",
            f"{format_duration(left)} left" if left and progress.done < progress.planned else "",
            counted(progress.error, "error") if progress.error else "",
        ]


class RecordingProgress(Display):
    """A bar for replayed episodes and snapshots."""

    def __init__(
        self,
        console: Console,
        count: int,
        *,
        activity: str = "recording",
        end: float = math.inf,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(console, transient=True, now=now)
        self._activity, self._end = activity, end
        self._count, self._done, self._began = count, 0, now()

    def __enter__(self) -> Self:
        super().__enter__()
        self._show("")
        return self

    def advance(self) -> None:
        """Count one more."""
        self._done += 1
        now = self._now()
        left_s, limit_s = (self._count - self._done) * (now - self._began) / self._done, self._end - now
        words = f"stops in {format_duration(limit_s)}" if limit_s < left_s else f"{format_duration(left_s)} left"
        self._show(f"  {words}" if min(left_s, limit_s) > 1 else "")

    def _show(self, left: str) -> None:
        text = f"{self._done}/{self._count}{left}"
        bar = ProgressBar(total=self._count, completed=self._done, width=30)
        table = Table.grid(padding=(0, 2))
        table.add_row(f"[bold]{self._activity}", bar, text)
        self.draw(lambda: table, lambda: [f"{self._activity}: {text}"])
