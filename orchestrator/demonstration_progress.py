"""Shows how a collection of demonstrations goes: live bars on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

from rich.console import Console
from rich.progress_bar import ProgressBar
from rich.table import Table

from orchestrator.display import Display
from orchestrator.lanes import Lane
from orchestrator.progress import format_duration


class DemonstrationProgress(Display):
    """A bar per task with kept and rejected episodes; below, the pace and the time left of all."""

    def __init__(self, console: Console, *, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__(console, now=now)
        self._began: tuple[float, int] | None = None

    def show(self, lanes: Sequence[Lane]) -> None:
        """Refresh what is shown."""
        kept = sum(lane.kept for lane in lanes)
        if self._began is None:
            self._began = self._now(), kept
            if kept:
                self.say(f"continuing: {kept} of {sum(lane.episodes for lane in lanes)} episodes are there already")
        self.draw(lambda: self._table(lanes), lambda: self._lines(lanes))

    def _lines(self, lanes: Sequence[Lane]) -> Iterator[str]:
        for lane in lanes:
            if lane.open and (lane.kept or lane.rejected or lane.errors):
                yield f"{lane.task}: {lane.kept}/{lane.episodes}{_rejections(lane)}"
        yield self._pace(lanes)

    def _table(self, lanes: Sequence[Lane]) -> Table:
        table = Table.grid(padding=(0, 2))
        for lane in lanes:
            table.add_row(
                f"[bold]{lane.task}",
                ProgressBar(total=lane.episodes, completed=lane.kept, width=30),
                f"{lane.kept}/{lane.episodes}{_rejections(lane)}",
            )
        table.add_row(self._pace(lanes))
        return table

    def _pace(self, lanes: Sequence[Lane]) -> str:
        assert self._began is not None
        began, before = self._began
        seconds = self._now() - began
        kept = sum(lane.kept for lane in lanes)
        wanted = sum(lane.episodes - lane.kept for lane in lanes if lane.open)
        if kept == before or seconds < 1.0:
            return "all: starting"
        pace = (kept - before) / seconds
        return f"all: {60 * pace:.0f} episodes/min, {format_duration(wanted / pace)} left"


def _rejections(lane: Lane) -> str:
    parts = [f", {lane.rejected} rejected" if lane.rejected else "", f", {lane.errors} errors" if lane.errors else ""]
    return "".join(parts)
