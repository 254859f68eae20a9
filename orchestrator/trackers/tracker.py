"""Sends a run to an experiment tracker: while it plays as its observer, or when it has ended."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar

from robogauntlet.orchestrator.runs.observer import PLAYING, Observer, RunState
from robogauntlet.orchestrator.trackers.tracked_run import (
    TrackedRun,
    TrackerError,
    check_project,
    place_of,
    tracked_run,
    usable,
)
from robogauntlet.orchestrator.trackers.videos import TrackedVideo, tracked_videos

if TYPE_CHECKING:
    from robogauntlet.orchestrator.runs.run_progress import RunProgress
    from robogauntlet.results.analysis.tables import Tables
    from robogauntlet.results.run_document import RunDocument

PROJECT = "robogauntlet"
"""Default project of W&B, experiment of MLflow."""
UPDATE_S = 30.0
"""Shortest time between two updates (s)."""


class TrackerName(StrEnum):
    """An experiment tracker."""

    WANDB = "wandb"
    MLFLOW = "mlflow"


class Tracker(Observer, ABC):
    """One run in an experiment tracker, by its library. Numbers, names and versions are sent, no free text.

    The step of a metric of the progress is the time since the run was created (s): a continued run goes on behind its
    last step, also offline, where the tracker does not know it.
    """

    name: ClassVar[TrackerName]
    label: ClassVar[str]
    """Its name in messages."""
    advice: ClassVar[str]
    """What to do if it refuses a run."""

    def __init__(self, project: str = PROJECT, say: Callable[[str], None] = lambda line: None) -> None:
        """Check that the tracker can be used on this machine; no server is contacted. `say` gets the run's address.

        Raises:
            TrackerError: The project's name is unusable, or the tracker's library or login is missing.
        """
        check_project(project)
        self._project, self._say = project, say
        self._updated = -UPDATE_S
        self.address: str | None = None
        """Where the run is, without a login, once it is open; for W&B offline, the command that uploads it."""
        self.check()

    @abstractmethod
    def check(self) -> None:
        """Raise TrackerError if the library or the login is missing."""

    @abstractmethod
    def open(self, run: TrackedRun, name: str) -> str:
        """Create the run under a displayed name, or continue the one of the same id. Return its address."""

    @abstractmethod
    def log(self, metrics: Mapping[str, float]) -> None:
        """Add metrics of this moment."""

    @abstractmethod
    def conclude(self, run: TrackedRun) -> None:
        """Write the results of a run that has ended, or that is sent as it is now."""

    @abstractmethod
    def add_videos(self, videos: Sequence[TrackedVideo]) -> None:
        """Add videos."""

    def finish(self) -> None:
        """Wait until everything is written."""

    def send(self, document: RunDocument, tables: Tables, name: str) -> str:
        """Send the results of a run and return where it is. Raises TrackerError if the tracker refuses."""
        run = tracked_run(document, tables)
        with self._refusals():
            address = self.open(run, name)
            self.conclude(run)
            self.finish()
        return address

    def on_start(self, run: RunState) -> None:
        """Open the run."""
        with self._live(run):
            self.address = self.open(tracked_run(run.document, None), run.folder.absolute().name)
        self._say(f"logging: {self.address}")

    def on_tick(self, run: RunState) -> None:
        """Send the progress, at most every `UPDATE_S`."""
        if run.phase == PLAYING and time.monotonic() - self._updated >= UPDATE_S:
            self._log_progress(run)

    def on_numbers(self, run: RunState) -> None:
        """Send the last progress and the results, as `send` does."""
        if self.address is None:
            return
        self._log_progress(run)
        with self._live(run):
            if run.report is None and run.done != 0:
                raise TrackerError("the results could not be computed")
            self.conclude(tracked_run(run.document, run.report.tables if run.report else None))

    def on_end(self, run: RunState) -> None:
        """Send the videos, and wait until everything is written."""
        if self.address is None:
            return
        with self._live(run):
            if videos := tracked_videos(run.folder, run.store.results):
                self.add_videos(videos)
            self.finish()
        self._say(f"logged: {self.address}")

    def _log_progress(self, run: RunState) -> None:
        self._updated = time.monotonic()
        with self._live(run):
            self.log(progress_metrics(run.progress))

    @contextmanager
    def _live(self, run: RunState) -> Iterator[None]:
        """Refusals, with the command that sends the results later."""
        try:
            with self._refusals():
                yield
        except TrackerError as error:
            command = f"robogauntlet export {run.folder} --tracker {self.name} --project {self._project!r}"
            raise TrackerError(f"{error}; the run goes on, to send its results later: {command}") from None

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        """Exceptions of the library as TrackerError."""
        try:
            yield
            return
        except TrackerError:
            raise
        except Exception as error:  # its text may contain secrets
            code = getattr(error, "error_code", None)
            problem = f"{type(error).__name__}{f' {code}' if isinstance(code, str) else ''}"
        raise TrackerError(f"{self.label} did not accept the run ({problem}); {self.advice}")


def progress_metrics(progress: RunProgress) -> dict[str, float]:
    """`progress/done`, `progress/success_rate/POLICY` and so on, with `/AXIS/SEVERITY` if perturbed."""
    listed = progress.simulators()
    found = {
        "progress/done": float(sum(it.done for it in listed)),
        "progress/planned": float(sum(it.planned for it in listed)),
        "progress/errors": float(sum(it.errors for it in listed)),
    }
    for it in listed:
        if it.per_minute is not None:
            found[f"progress/episodes_per_minute/{usable(it.simulator)}"] = it.per_minute
    for policy, axis, severity, counts in progress.conditions():
        if counts.rate is not None and counts.interval is not None:
            place = place_of(policy, axis=axis, severity=severity)
            found[f"progress/success_rate/{place}"] = counts.rate
            found[f"progress/success_rate_low/{place}"] = counts.interval.low
            found[f"progress/success_rate_high/{place}"] = counts.interval.high
            found[f"progress/n/{place}"] = float(counts.verdicts)
    return found
