"""Shows how a run goes: live bars on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType

from rich.console import Console
from rich.progress_bar import ProgressBar
from rich.table import Table

from orchestrator.display import Display
from orchestrator.plan import Plan
from orchestrator.runner import Readiness
from results.live import LiveSimulator
from results.record import EpisodeResult

WINDOW_S = 60.0
"""Stretch of time over which the pace is measured."""


@dataclass
class _Lane:
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
        """Episodes a minute over the last `WINDOW_S`."""
        while self.recent and now - self.recent[0][0] > WINDOW_S:
            self.recent.popleft()
        if self.ready_at is None or not self.recent:
            return None
        return sum(n for _, n in self.recent) / max(min(now - self.ready_at, WINDOW_S), 1.0) * 60.0

    def left_s(self, now: float) -> float | None:
        """Expected time left (s)."""
        pace = self.per_minute(now)
        return (self.planned - self.done) / pace * 60.0 if pace else None


class Progress(Display):
    """A bar per simulator with success so far, episodes per minute and time left."""

    def __init__(self, console: Console, *, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__(console, now=now)
        self._lanes: dict[str, _Lane] = {}

    def begin(self, plan: Plan, counts: Mapping[tuple[str, str], int]) -> None:
        """Set up the bars. `counts`: rows there already, by (simulator, status)."""
        per_simulator = {name: 0 for name in plan.simulators if name not in plan.unavailable}
        for cell in plan.cells:
            if cell.simulator in per_simulator:
                per_simulator[cell.simulator] += plan.suite.seeds.count
        self._lanes = {name: _Lane(planned) for name, planned in per_simulator.items()}
        for (name, status), count in counts.items():
            if name in self._lanes:
                setattr(self._lanes[name], status, count)
        already = sum(counts.values())
        if already:
            self.say(f"continuing: {already} of {plan.episodes} episodes are done already")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.draw(self._table, self._lines, at_once=True)
        super().__exit__(kind, error, trace)

    def started(self, simulator: str, readiness: Readiness) -> None:
        """A worker has opened its simulator."""
        lane = self._lanes[simulator]
        if lane.ready_at is None:
            lane.ready_at = self._now()
            frame = f", {1000 * readiness.frame_s:.0f} ms a look" if readiness.frame_s else ""
            self.say(f"{simulator}: ready (renders on {readiness.render_device}{frame})")

    def came(self, results: Sequence[EpisodeResult]) -> None:
        """Count rows that came back."""
        now = self._now()
        for (name, status), count in Counter((r.simulator, r.status) for r in results).items():
            lane = self._lanes[name]
            setattr(lane, status, getattr(lane, status) + count)
            lane.recent.append((now, count))

    def tick(self) -> None:
        """Refresh what is shown."""
        self.draw(self._table, lambda: self._lines(finished=False))

    def live(self) -> tuple[LiveSimulator, ...]:
        """The same as plain values."""
        now = self._now()
        return tuple(
            LiveSimulator(
                simulator=name,
                planned=lane.planned,
                successes=lane.success,
                failures=lane.failure,
                errors=lane.error,
                per_minute=lane.per_minute(now),
                left_s=lane.left_s(now),
            )
            for name, lane in self._lanes.items()
        )

    def filming(self, count: int) -> FilmingProgress:
        """What shows how the filming of so many episodes and looks goes."""
        return FilmingProgress(self._console, count, now=self._now)

    def _table(self) -> Table:
        table = Table.grid(padding=(0, 2))
        for name, lane in self._lanes.items():
            table.add_row(
                f"[bold]{name}",
                ProgressBar(total=max(lane.planned, 1), completed=lane.done, width=30),
                f"{lane.done}/{lane.planned}",
                *self._figures(lane),
            )
        return table

    def _lines(self, *, finished: bool = True) -> Iterator[str]:
        for name, lane in self._lanes.items():
            if lane.done >= lane.planned and not finished:
                continue
            yield "  ".join(filter(None, [f"{name}: {lane.done}/{lane.planned}", *self._figures(lane)]))

    def _figures(self, lane: _Lane) -> list[str]:
        now = self._now()
        judged = lane.success + lane.failure
        pace, left = lane.per_minute(now), lane.left_s(now)
        return [
            f"success {100 * lane.success / judged:.0f} %" if judged else "",
            f"{pace:.0f} episodes/min" if pace and lane.done < lane.planned else "",
            f"{format_duration(left)} left" if left and lane.done < lane.planned else "",
            f"{lane.error} errors" if lane.error else "",
        ]


class FilmingProgress(Display):
    """A bar of what is filmed, or played again for another end."""

    def __init__(
        self, console: Console, count: int, *, what: str = "filming", now: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(console, transient=True, now=now)
        self._what = what
        self._count, self._done, self._began = count, 0, now()

    def came(self) -> None:
        """One more is done."""
        self._done += 1
        left_s = (self._count - self._done) * (self._now() - self._began) / self._done
        words = f"{self._done}/{self._count}" + (f"  {format_duration(left_s)} left" if left_s > 1 else "")
        bar = ProgressBar(total=self._count, completed=self._done, width=30)
        table = Table.grid(padding=(0, 2))
        table.add_row(f"[bold]{self._what}", bar, words)
        self.draw(lambda: table, lambda: [f"{self._what}: {words}"])


def format_duration(seconds: float) -> str:
    """`45 s`, `3 min 20 s`, `2 h 5 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
