"""What watches a run: displays, histories and experiment trackers. A run knows none of them by name."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from robogauntlet.results.live_status import LiveStatus, LiveWorker

if TYPE_CHECKING:
    from robogauntlet.orchestrator.runs.plan import Plan
    from robogauntlet.orchestrator.runs.run_progress import RunProgress
    from robogauntlet.results.record import EpisodeResult
    from robogauntlet.results.report import Report
    from robogauntlet.results.run_document import RunDocument
    from robogauntlet.results.store.episode_store import Store
    from robogauntlet.results.store.history_records import CellKey, Counts

SHOWN_WARNINGS = 10
"""Number of messages in the live status, the latest ones."""
PLAYING, RECORDING = "playing", "recording videos"


@dataclass
class Recording:
    """The recording of videos and snapshots."""

    count: int
    end: float
    """The latest end, by the clock `time.monotonic`."""
    done: int = 0


@dataclass
class RunState:
    """A run while it plays, and its outcome. Observers read it; only the run changes it."""

    plan: Plan
    document: RunDocument
    folder: Path
    store: Store
    """The rows; closed when the run has ended."""
    progress: RunProgress
    is_own: bool = True
    """Whether this user played all rows that were there at the beginning."""
    phase: str = PLAYING
    workers: Callable[[], Sequence[LiveWorker]] = tuple
    """Returns what each worker is doing."""
    recording: Recording | None = None
    warnings: list[str] = field(default_factory=list)
    """Messages for the user, a line each."""
    skipped: dict[str, str] = field(default_factory=dict)
    """Simulator to the reason why it cannot run here."""
    render_devices: dict[str, str] = field(default_factory=dict)
    cells: Mapping[CellKey, Counts] | None = None
    """Counts of the rows by cell, once the last episode has ended; None if they cannot be read."""
    report: Report | None = None
    """None before the last episode has ended, or if it could not be written."""
    media_interrupted: bool = False
    """Whether the recording of videos was interrupted, after everything else was complete."""

    @property
    def done(self) -> int | None:
        """Rows in the store at the end; None if it cannot be read."""
        return None if self.cells is None else sum(counts.done for counts in self.cells.values())

    def live(self) -> LiveStatus:
        """The status at this moment."""
        return LiveStatus(
            at=time.time(),
            phase=self.phase,
            simulators=self.progress.simulators(),
            left_s=self.progress.left_s(),
            workers=tuple(self.workers()),
            messages=tuple(self.warnings[-SHOWN_WARNINGS:]),
        )


class Observer:
    """Watches a run. Whatever it raises is a warning of the run, which goes on without it."""

    def on_start(self, run: RunState) -> None:
        """The run begins or continues."""

    def on_rows(self, rows: Sequence[EpisodeResult]) -> None:
        """Workers have returned rows, which are stored within a second or two and counted in `RunState.progress`."""

    def on_tick(self, run: RunState) -> None:
        """Called several times a second while episodes are played, and after each recorded video."""

    def on_line(self, line: str) -> None:
        """The run says something, which is no warning."""

    def on_warning(self, warning: str) -> None:
        """The run warns of something, in a line, while it plays."""

    def on_numbers(self, run: RunState) -> None:
        """The last episode has ended and the report is written; videos follow."""

    def on_end(self, run: RunState) -> None:
        """Everything is written."""

    def close(self) -> None:
        """Free what the observer holds; called once, also after a hook or the run has raised."""
