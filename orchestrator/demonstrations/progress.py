"""Shows the progress of a collection of demonstrations."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

from rich.console import Console
from rich.progress_bar import ProgressBar
from rich.table import Table

from robogauntlet.orchestrator.demonstrations.task_queue import CollectionTask
from robogauntlet.orchestrator.live_display import Display
from robogauntlet.support.durations import format_duration
from robogauntlet.support.text import counted


class DemonstrationProgress(Display):
    """A bar per task with kept and rejected episodes, and the pace and the time left of all tasks."""

    def __init__(self, console: Console, *, now: Callable[[], float] = time.monotonic) -> None:
        super().__init__(console, now=now)
        self._began, self._before = now(), 0

    def begin(self, tasks: Sequence[CollectionTask]) -> None:
        """Say how many episodes exist already, and measure the pace from here on."""
        self._began, self._before = self._now(), sum(task.kept for task in tasks)
        if self._before:
            wanted = counted(sum(task.episodes for task in tasks), "episode")
            self.log(f"continuing: {self._before} of {wanted} already there")

    def show(self, tasks: Sequence[CollectionTask]) -> None:
        """Update the display."""
        self.draw(lambda: self._table(tasks), lambda: self._lines(tasks))

    def _lines(self, tasks: Sequence[CollectionTask]) -> Iterator[str]:
        for task in tasks:
            if task.open and (task.kept or task.rejected or task.errors):
                yield f"{task.name}: {task.kept}/{task.episodes}{_rejections(task)}"
        yield self._pace(tasks)

    def _table(self, tasks: Sequence[CollectionTask]) -> Table:
        table = Table.grid(padding=(0, 2))
        for task in tasks:
            table.add_row(
                f"[bold]{task.name}",
                ProgressBar(total=task.episodes, completed=task.kept, width=30),
                f"{task.kept}/{task.episodes}{_rejections(task)}",
            )
        table.add_row(self._pace(tasks))
        return table

    def _pace(self, tasks: Sequence[CollectionTask]) -> str:
        seconds = self._now() - self._began
        kept = sum(task.kept for task in tasks)
        wanted = sum(task.episodes - task.kept for task in tasks if task.open)
        if kept == self._before or seconds < 1.0:
            return "all: starting"
        pace = (kept - self._before) / seconds
        return f"all: {60 * pace:.0f} episodes/min, {format_duration(wanted / pace)} left"


def _rejections(task: CollectionTask) -> str:
    rejected = f", {task.rejected} rejected" if task.rejected else ""
    return rejected + (f", {counted(task.errors, 'error')}" if task.errors else "")
