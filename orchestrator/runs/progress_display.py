"""Shows the progress of a run."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Self

from rich.console import Console
from rich.progress_bar import ProgressBar
from rich.table import Table

from robogauntlet.orchestrator.live_display import Display
from robogauntlet.orchestrator.runs.observer import PLAYING, Observer, RunState
from robogauntlet.orchestrator.runs.run_progress import RunProgress
from robogauntlet.results.live_status import LiveSimulator
from robogauntlet.results.record import EpisodeResult, outcome_text
from robogauntlet.suites.episode import CLEAN, Condition
from robogauntlet.support.durations import format_duration, format_range
from robogauntlet.support.errors import first_line
from robogauntlet.support.text import counted


class ProgressDisplay(Display, Observer):
    """A bar per simulator with the success so far of a single policy and episodes per minute; time left of the run.

    If it is verbose, it also prints a line for each episode. While videos are recorded, it shows one bar for them.
    """

    def __init__(self, console: Console, *, verbose: bool = False, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__(console, now=now)
        self._verbose = verbose
        self._progress: RunProgress | None = None
        """What is shown, from the first moment of playing to the last."""
        self._recording: RecordingProgress | None = None

    def on_rows(self, rows: Sequence[EpisodeResult]) -> None:
        """Print a line for each row, if it is verbose."""
        for row in rows if self._verbose else ():
            condition = "" if row.axis == CLEAN else f" under {Condition(row.axis, row.severity)}"
            reason = f": {first_line(row.error)}" if row.error else ""
            episode = f"{row.task}, {row.policy}{condition}, seed {row.seed}"
            outcome = outcome_text(row.status, row.failure)
            self.log(f"{episode}: {outcome} in {counted(row.steps, 'step')}, {row.wall_s:.2f} s{reason}")

    def on_tick(self, run: RunState) -> None:
        """Update the display."""
        if (recording := run.recording) is not None:
            if self._recording is None:
                self._recording = RecordingProgress(self._console, recording.count, end=recording.end, now=self._now)
                self._recording.__enter__()
            if recording.done:
                self._recording.show(recording.done)
        elif run.phase == PLAYING:
            if self._progress is None:
                self._progress = run.progress
                self.__enter__()
            self.draw(self._table, lambda: self._lines(finished=False))
        else:
            self._end_recording()

    def on_line(self, line: str) -> None:
        """Print it."""
        self.log(line)

    def on_warning(self, warning: str) -> None:
        """Print it."""
        self.log(warning)

    def on_numbers(self, run: RunState) -> None:
        """Leave the last state of the bars."""
        if self._progress is not None:
            self.draw(self._table, self._lines, at_once=True)
        self.close()

    def close(self) -> None:
        """Give the terminal back."""
        self._end_recording()
        self._progress = None
        self.__exit__()

    def _end_recording(self) -> None:
        if self._recording is not None:
            self._recording.__exit__()
        self._recording = None

    def _shown(self) -> tuple[LiveSimulator, ...]:
        return self._progress.simulators() if self._progress is not None else ()

    def _table(self) -> Table:
        table = Table.grid(padding=(0, 2))
        for live in self._shown():
            table.add_row(
                f"[bold]{live.simulator}",
                ProgressBar(total=max(live.planned, 1), completed=live.done, width=30),
                f"{live.done}/{live.planned}",
                *self._figures(live),
            )
        if left := self._left():
            table.add_row("", "", "", left)
        return table

    def _lines(self, *, finished: bool = True) -> Iterator[str]:
        for live in self._shown():
            if live.done >= live.planned and not finished:
                continue
            yield "  ".join(filter(None, [f"{live.simulator}: {live.done}/{live.planned}", *self._figures(live)]))
        if left := None if finished else self._left():
            yield f"all: {left}"

    def _left(self) -> str | None:
        left_s = None if self._progress is None else self._progress.left_s()
        return None if left_s is None else f"{format_range(*left_s)} left"

    def _figures(self, live: LiveSimulator) -> list[str]:
        valid, pace = live.successes + live.failures, live.per_minute
        single = self._progress is not None and self._progress.policies == 1
        return [
            # Several policies have no rate in common.
            f"success {100 * live.successes / valid:.0f} %" if valid and single else "",
            f"{pace:.0f} episodes/min" if pace and live.done < live.planned else "",
            counted(live.errors, "error") if live.errors else "",
        ]


class RecordingProgress(Display):
    """A bar for recorded episodes and snapshots."""

    def __init__(
        self, console: Console, count: int, *, end: float = math.inf, now: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(console, transient=True, now=now)
        self._end = end
        self._count, self._done, self._began = count, 0, now()

    def __enter__(self) -> Self:
        super().__enter__()
        self._show("")
        return self

    def show(self, done: int) -> None:
        """Show that this number, one or more, is done."""
        self._done, now = done, self._now()
        left_s, limit_s = (self._count - self._done) * (now - self._began) / self._done, self._end - now
        words = f"stops in {format_duration(limit_s)}" if limit_s < left_s else f"{format_duration(left_s)} left"
        self._show(f"  {words}" if min(left_s, limit_s) > 1 else "")

    def _show(self, left: str) -> None:
        text = f"{self._done}/{self._count}{left}"
        bar = ProgressBar(total=self._count, completed=self._done, width=30)
        table = Table.grid(padding=(0, 2))
        table.add_row("[bold]recording", bar, text)
        self.draw(lambda: table, lambda: [f"recording: {text}"])
