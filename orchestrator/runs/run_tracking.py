"""Sends one run to an experiment tracker, if the user asks for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from robogauntlet.orchestrator.runs.progress import Progress
from robogauntlet.orchestrator.trackers.live_tracker import LiveTracker
from robogauntlet.orchestrator.trackers.run_progress import RunProgress
from robogauntlet.orchestrator.trackers.tracked_run import tracked_run
from robogauntlet.orchestrator.trackers.videos import tracked_videos
from robogauntlet.results.analysis.tables import Tables
from robogauntlet.results.record import EpisodeResult
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store.episode_store import Store, StoreError


class RunTracking:
    """What a run tells its experiment tracker. Without a tracker it does nothing."""

    def __init__(
        self, tracker: LiveTracker | None, document: RunDocument, folder: Path, store: Store, progress: Progress
    ) -> None:
        """Open the run in the tracker."""
        self._tracker, self._folder, self._progress = tracker, folder, progress
        self._shown = False
        if tracker is not None:
            self._counts = RunProgress(document, store.outcomes())
            tracker.open(tracked_run(document, None), folder.absolute().name, str(folder))

    def on_results(self, results: Sequence[EpisodeResult]) -> None:
        """Workers have returned rows."""
        if self._tracker is not None:
            self._counts.count(results)

    def on_tick(self, on_warning: Callable[[str], None]) -> None:
        """Send the progress if it is time, and hand a warning on."""
        if self._tracker is None:
            return
        self._tracker.update(lambda: self._counts.metrics(self._progress.live()))
        if self._tracker.address is not None and not self._shown:
            self._shown = True
            self._progress.log(f"logging: {self._tracker.address}")
        if (warning := self._tracker.take_warning()) is not None:
            on_warning(warning)

    def conclude(self, document: RunDocument, tables: Tables | None) -> None:
        """Send the results of what was played; without tables, which could not be computed, only the progress."""
        if self._tracker is not None:
            run = None if tables is None else tracked_run(document, tables)
            self._tracker.conclude(run, self._counts.metrics(self._progress.live()))

    def finish(self, rows: Callable[[], Iterable[EpisodeResult]]) -> tuple[str | None, list[str]]:
        """Send the videos and wait a moment for the tracker. Return where the run is, if all was sent, and warnings."""
        if self._tracker is None:
            return None, []
        try:
            videos = tracked_videos(self._folder, rows)
        except (OSError, StoreError):  # the report has warned of it
            videos = []
        self._tracker.finish(videos)
        warning = self._tracker.take_warning()
        return self._tracker.address if self._tracker.complete else None, [] if warning is None else [warning]
