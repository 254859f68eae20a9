"""The contract of an experiment tracker, and the sending of a finished run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib import import_module
from typing import TYPE_CHECKING, Protocol, cast

from robogauntlet.orchestrator.trackers.tracked_run import TrackedRun, TrackerError, check_project, tracked_run

if TYPE_CHECKING:  # the process of a tracker starts without them
    from robogauntlet.results.analysis.tables import Tables
    from robogauntlet.results.run_document import RunDocument

PROJECT = "robogauntlet"
"""Default project of W&B, experiment of MLflow."""


class Tracker(StrEnum):
    """An experiment tracker."""

    WANDB = "wandb"
    MLFLOW = "mlflow"

    @property
    def label(self) -> str:
        """Its name in messages."""
        return {"wandb": "W&B", "mlflow": "MLflow"}[self]


@dataclass(frozen=True)
class TrackedVideo:
    """A recorded episode."""

    name: str
    """`POLICY/TASK/STATUS`, in characters that every tracker accepts."""
    path: str
    """The mp4 file."""


class TrackerSession(Protocol):
    """One run that is open in a tracker. Methods raise TrackerError if the tracker refuses."""

    address: str
    """Where the run is, without a login; for W&B offline, the command that uploads it."""

    def log_progress(self, metrics: Mapping[str, float]) -> None:
        """Add the metrics of one moment of the run."""

    def conclude(self, run: TrackedRun) -> None:
        """Write the results of a run that ended, or that is sent as it is now."""

    def add_videos(self, videos: Sequence[TrackedVideo]) -> None:
        """Add videos."""

    def finish(self) -> None:
        """Wait until everything is written."""


class TrackerModule(Protocol):
    """The functions that the module of a tracker has."""

    def check(self) -> None:
        """Raise TrackerError if the tracker's library or the login is missing. No server is contacted."""

    def open_session(self, run: TrackedRun, *, name: str, project: str) -> TrackerSession:
        """Create the run, or continue the one of the same id, under a displayed name. Raises TrackerError."""


def module_of(tracker: Tracker) -> TrackerModule:
    """The module of a tracker, without its library."""
    return cast(TrackerModule, import_module(f"robogauntlet.orchestrator.trackers.{tracker.value}"))


def read_tracker(name: str) -> Tracker:
    """The tracker of this name. Raises TrackerError if there is none."""
    try:
        return Tracker(name)
    except ValueError:
        raise TrackerError(f"log: expected an experiment tracker, {' or '.join(Tracker)}, got {name!r}") from None


def log_run(tracker: Tracker, document: RunDocument, tables: Tables, *, name: str, project: str) -> str:
    """Send numbers, provenance and tags of a run to a tracker and return where it is.

    Raises:
        TrackerError: The library is missing, or the tracker refuses the run.
    """
    check_project(project)
    run = tracked_run(document, tables)
    session = module_of(tracker).open_session(run, name=name, project=project)
    session.conclude(run)
    session.finish()
    return session.address
