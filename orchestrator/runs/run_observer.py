"""Observes the scheduler for one run: progress on the terminal, live status in the stores, warnings for the report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

from robogauntlet.orchestrator.episodes.lease import Readiness
from robogauntlet.orchestrator.runs.history_writer import HistoryWriter
from robogauntlet.orchestrator.runs.progress import Progress
from robogauntlet.orchestrator.runs.run_tracking import RunTracking
from robogauntlet.orchestrator.scheduling.scheduler import Observer
from robogauntlet.results.live_status import LiveStatus, LiveWorker
from robogauntlet.results.record import EpisodeResult
from robogauntlet.results.run_document import RunDocument, shortened
from robogauntlet.support.text import counted

SHOWN_WARNINGS = 10
"""Number of messages in the live status, the latest ones."""


class RunObserver(Observer[EpisodeResult]):
    """Collects skipped simulators, render devices and warnings."""

    def __init__(
        self,
        document: RunDocument,
        unavailable: Mapping[str, str],
        progress: Progress,
        history_writer: HistoryWriter,
        tracking: RunTracking,
        on_tick: Callable[[], None],
    ) -> None:
        """Observe a run from its start. `on_tick` is called whenever the live status may have changed."""
        self._run_id, self._phase = document.run_id, "playing"
        self._progress, self._history_writer, self._on_tick = progress, history_writer, on_tick
        self._tracking = tracking
        self.render_devices: dict[str, str] = dict(document.render_devices)
        self.skipped_simulators: dict[str, str] = {name: shortened(why) for name, why in unavailable.items()}
        self.warnings: list[str] = [f"{name} is skipped: {reason}" for name, reason in unavailable.items()]
        """Messages for the user, a line each."""

    def on_started(self, simulator: str, readiness: Readiness) -> None:
        """A worker has opened its simulator."""
        self.render_devices[simulator] = readiness.render_device
        self._progress.on_started(simulator, readiness)

    def on_skipped(self, simulator: str, reason: str, episodes: int) -> None:
        """A simulator cannot run here."""
        self.skipped_simulators[simulator] = shortened(reason)
        self.on_warning(f"{simulator} is skipped ({counted(episodes, 'episode')}): {reason}")

    def on_results(self, results: Sequence[EpisodeResult]) -> None:
        """Workers have returned rows."""
        self._tracking.on_results(results)
        self._progress.on_results(results)

    def on_warning(self, message: str) -> None:
        """Show a warning now, and keep it for the end of the run."""
        self.warnings.append(message)
        self._progress.log(message)

    def on_tick(self, activity: Callable[[], Sequence[LiveWorker]]) -> None:
        """Time has passed; `activity` returns what each worker is doing."""
        self._progress.on_tick()
        self._tracking.on_tick(self.on_warning)
        self._publish(activity)

    def on_media_tick(self) -> None:
        """A video or snapshot has been recorded, after all episodes were played."""
        self._phase = "recording videos"
        self._publish(tuple)

    def _publish(self, activity: Callable[[], Sequence[LiveWorker]]) -> None:
        def live() -> LiveStatus:
            return LiveStatus(
                at=time.time(),
                phase=self._phase,
                simulators=self._progress.live(),
                workers=tuple(activity()),
                messages=tuple(self.warnings[-SHOWN_WARNINGS:]),
            )

        self._history_writer.update_live_status(self._run_id, live)
        self._on_tick()
