"""Tells the observers of a run what happens, in one stream."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Self

from robogauntlet.orchestrator.episodes.lease import Readiness
from robogauntlet.orchestrator.runs.observer import Observer, RunState
from robogauntlet.orchestrator.scheduling.scheduler import SchedulerObserver
from robogauntlet.results.live_status import LiveWorker
from robogauntlet.results.record import EpisodeResult
from robogauntlet.results.run_document import shortened
from robogauntlet.results.store.database import StoreError
from robogauntlet.support.errors import UserError, describe
from robogauntlet.support.text import counted


class Observers(SchedulerObserver[EpisodeResult]):
    """Tells the observers of a run what the scheduler and the run do. A context manager, which closes them."""

    def __init__(self, observers: Sequence[Observer], run: RunState) -> None:
        self._observers, self._run = list(observers), run

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for observer in self._observers:
            observer.close()

    def start(self) -> None:
        """Tell the observers that the run begins."""
        self._tell(lambda observer: observer.on_start(self._run))

    def on_started(self, simulator: str, readiness: Readiness) -> None:
        """A worker has opened its simulator."""
        self._run.render_devices[simulator] = readiness.render_device
        if self._run.progress.started(simulator):
            frame = f", {1000 * readiness.frame_s:.0f} ms per observation" if readiness.frame_s else ""
            self.on_line(f"{simulator}: ready (renders on {readiness.render_device}{frame})")

    def on_skipped(self, simulator: str, reason: str, episodes: int) -> None:
        """A simulator cannot run here."""
        self._run.skipped[simulator] = shortened(reason)
        self.on_warning(f"{simulator} is skipped ({counted(episodes, 'episode')}): {reason}")

    def on_results(self, results: Sequence[EpisodeResult]) -> None:
        """Workers have returned rows."""
        self._run.progress.count(results)
        self._tell(lambda observer: observer.on_rows(results))

    def on_tick(self, activity: Callable[[], Sequence[LiveWorker]] = tuple) -> None:
        """Time has passed; `activity` returns what each worker is doing."""
        self._run.workers = activity
        self._tell(lambda observer: observer.on_tick(self._run))

    def on_line(self, line: str) -> None:
        """Show a line now."""
        self._tell(lambda observer: observer.on_line(line))

    def on_warning(self, message: str) -> None:
        """Show a warning now, and keep it for the end of the run."""
        self._run.warnings.append(message)
        self._tell(lambda observer: observer.on_warning(message))

    def on_numbers(self) -> None:
        """The last episode has ended and the report is written."""
        self._tell(lambda observer: observer.on_numbers(self._run), ended=True)

    def on_end(self) -> None:
        """Everything is written."""
        self._tell(lambda observer: observer.on_end(self._run), ended=True)

    def _tell(self, tell: Callable[[Observer], None], *, ended: bool = False) -> None:
        """Call a hook of each observer; one that raises is closed and told nothing more.

        When the last episode has `ended`, warnings are shown by whoever shows the outcome, and Ctrl-C ends only what an
        observer still does.
        """
        for observer in tuple(self._observers):
            if observer not in self._observers:
                continue  # its warning of another one's failure failed
            try:
                tell(observer)
            except KeyboardInterrupt:
                if not ended:
                    raise
                warning = f"{type(observer).__name__} was interrupted"
            except (UserError, StoreError) as error:
                warning = str(error)
            except Exception as error:
                warning = f"{type(observer).__name__}: {describe(error)}"
            else:
                continue
            self._observers.remove(observer)
            observer.close()
            if ended:
                self._run.warnings.append(warning)
            else:
                self.on_warning(warning)
