"""Sends a run to MLflow: a server, a database or a folder, as set by MLFLOW_TRACKING_URI.

Server and login are MLflow's own settings (MLFLOW_TRACKING_URI and others). The experiment may be new.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from robogauntlet.orchestrator.trackers.tracked_run import TrackedRun, TrackerError
from robogauntlet.orchestrator.trackers.tracker import TrackedVideo
from robogauntlet.results.run_document import RunStatus

STATUSES = {
    RunStatus.RUNNING: "RUNNING",
    RunStatus.COMPLETE: "FINISHED",
    RunStatus.INTERRUPTED: "KILLED",
    RunStatus.STOPPED: "FAILED",
}
TAG = "robogauntlet_run_id"
"""Tag that identifies a run that was sent before."""
PIECE = 500
"""Metrics per request; MLflow accepts at most 1,000 metrics and 100 parameters or tags."""


class MlflowSession:
    """One run that is open in MLflow. The step of a metric of its progress is the time since its creation (s)."""

    def __init__(self, client: Any, run: str, project: str, started_at: float) -> None:
        self._client, self._run, self._started_at = client, run, started_at
        self.address = f"{_shown(client.tracking_uri)}, experiment {project}, run {run}"

    def log_progress(self, metrics: Mapping[str, float]) -> None:
        """Add the metrics of one moment of the run."""
        with _refusals():
            self._log(metrics, step=int(time.time() - self._started_at))

    def conclude(self, run: TrackedRun) -> None:
        """Write the results, `cells.csv` and the status of the run."""
        with _refusals():
            self._describe(run)
            self._log(run.metrics, step=0)
            self._client.log_text(self._run, run.cells, "cells.csv")
            if run.ended_at is not None:
                self._client.set_terminated(self._run, STATUSES[RunStatus(run.status)], int(1000 * run.ended_at))

    def add_videos(self, videos: Sequence[TrackedVideo]) -> None:
        """Add videos as files, `videos/POLICY/TASK/STATUS.mp4`."""
        with _refusals(), tempfile.TemporaryDirectory(prefix="robogauntlet-") as folder:
            for video in videos:
                copy = Path(folder) / "videos" / f"{video.name}.mp4"
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(video.path, copy)
            self._client.log_artifacts(self._run, folder)

    def finish(self) -> None:
        """Nothing: every request has been answered."""

    def start(self, run: TrackedRun) -> None:
        """Write what is known of a run at its start; a run that is continued is running again."""
        self._describe(run)
        self._client.update_run(self._run, status=STATUSES[RunStatus(run.status)])

    def _describe(self, run: TrackedRun) -> None:
        from mlflow.entities import Param, RunTag

        params = [Param(key, str(value)) for key, value in run.provenance.items()]
        labels = [RunTag(f"robogauntlet/{key}", str(value)) for key, value in run.state.items()]
        labels += [RunTag(tag, "yes") for tag in run.tags]
        for i in range(0, max(len(params), len(labels)), PIECE // 5):
            self._client.log_batch(self._run, params=params[i : i + PIECE // 5], tags=labels[i : i + PIECE // 5])

    def _log(self, metrics: Mapping[str, float], *, step: int) -> None:
        from mlflow.entities import Metric

        now = int(1000 * time.time())
        entries = [Metric(key, value, now, step) for key, value in metrics.items()]
        for i in range(0, len(entries), PIECE):
            self._client.log_batch(self._run, metrics=entries[i : i + PIECE])


def check() -> None:
    """Raise TrackerError if MLflow is missing."""
    _library()


def open_session(run: TrackedRun, *, name: str, project: str) -> MlflowSession:
    """Create the run in MLflow, or continue the one of the same id."""
    client_class = _library()
    with _refusals():
        client = client_class()
        known = client.get_experiment_by_name(project)
        experiment = client.create_experiment(project) if known is None else known.experiment_id
        run_id = run.run_id.replace("'", "")
        earlier = client.search_runs([experiment], f"tags.{TAG} = '{run_id}'", max_results=1)
        started = int(1000 * run.started_at)
        if earlier:
            found = earlier[0].info.run_id
        else:
            found = client.create_run(experiment, start_time=started, tags={TAG: run_id}, run_name=name).info.run_id
        session = MlflowSession(client, str(found), project, run.started_at)
        session.start(run)
        return session


@contextmanager
def _refusals() -> Iterator[None]:
    """Exceptions of the library as TrackerError."""
    try:
        yield
        return
    except Exception as error:  # its text may contain the address with a login
        code = getattr(error, "error_code", None)
        problem = f"{type(error).__name__}{f' {code}' if isinstance(code, str) else ''}"
    raise TrackerError(f"MLflow did not accept the run ({problem}); check MLFLOW_TRACKING_URI, its login and --project")


def _library() -> Any:
    """Import MLflow and return its client class."""
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "3")  # the default retries for minutes
    try:
        import alembic  # noqa: F401  mlflow needs it for databases, mlflow-skinny lacks it
        from mlflow.tracking import MlflowClient
    except ImportError:
        raise TrackerError('MLflow is not installed; install it with: pip install "robogauntlet[mlflow]"') from None
    return MlflowClient


def _shown(address: str) -> str:
    """The address without login and options."""
    parts = urlsplit(address)
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}" if parts.netloc else address.partition("?")[0]
