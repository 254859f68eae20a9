"""Sends a run to MLflow: a server, a database or a folder, as set by MLFLOW_TRACKING_URI.

Server and login are MLflow's own settings (MLFLOW_TRACKING_URI and others). The experiment may be new.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from robogauntlet.orchestrator.trackers.tracked_run import TrackedRun, TrackerError
from robogauntlet.orchestrator.trackers.tracker import Tracker, TrackerName
from robogauntlet.orchestrator.trackers.videos import TrackedVideo
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
SETTINGS = {
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_LOGGING_LEVEL": "WARNING",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "10",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
}
"""MLflow's own settings, unless the user has set them. By default it waits for minutes, and a run waits with it."""


class MlflowTracker(Tracker):
    """One run in MLflow."""

    name = TrackerName.MLFLOW
    label = "MLflow"
    advice = "check MLFLOW_TRACKING_URI, its login and --project"
    _run: str
    _started_at = 0.0

    def check(self) -> None:
        """See `Tracker`."""
        self._client_class = _library()

    def open(self, run: TrackedRun, name: str) -> str:
        """See `Tracker`."""
        self._client = client = self._client_class()
        self._started_at = run.started_at
        known = client.get_experiment_by_name(self._project)
        experiment = client.create_experiment(self._project) if known is None else known.experiment_id
        run_id = run.run_id.replace("'", "")
        earlier = client.search_runs([experiment], f"tags.{TAG} = '{run_id}'", max_results=1)
        started = int(1000 * run.started_at)
        if not earlier:
            earlier = [client.create_run(experiment, start_time=started, tags={TAG: run_id}, run_name=name)]
        self._run = str(earlier[0].info.run_id)
        self._describe(run)
        client.update_run(self._run, status=STATUSES[RunStatus(run.status)])
        return f"{_shown(client.tracking_uri)}, experiment {self._project}, run {self._run}"

    def log(self, metrics: Mapping[str, float]) -> None:
        """See `Tracker`."""
        self._log(metrics, step=int(time.time() - self._started_at))

    def _log(self, metrics: Mapping[str, float], *, step: int) -> None:
        from mlflow.entities import Metric

        now = int(1000 * time.time())
        entries = [Metric(key, value, now, step) for key, value in metrics.items()]
        for i in range(0, len(entries), PIECE):
            self._client.log_batch(self._run, metrics=entries[i : i + PIECE])

    def conclude(self, run: TrackedRun) -> None:
        """See `Tracker`."""
        self._describe(run)
        self._log(run.metrics, step=0)
        self._client.log_text(self._run, run.cells, "cells.csv")
        if run.ended_at is not None:
            self._client.set_terminated(self._run, STATUSES[RunStatus(run.status)], int(1000 * run.ended_at))

    def add_videos(self, videos: Sequence[TrackedVideo]) -> None:
        """Add videos as files, `videos/POLICY/TASK/STATUS.mp4`."""
        with tempfile.TemporaryDirectory(prefix="robogauntlet-") as folder:
            for video in videos:
                copy = Path(folder) / "videos" / f"{video.name}.mp4"
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(video.path, copy)
            self._client.log_artifacts(self._run, folder)

    def _describe(self, run: TrackedRun) -> None:
        from mlflow.entities import Param, RunTag

        params = [Param(key, str(value)) for key, value in run.provenance.items()]
        labels = [RunTag(f"robogauntlet/{key}", str(value)) for key, value in run.state.items()]
        labels += [RunTag(tag, "yes") for tag in run.tags]
        for i in range(0, max(len(params), len(labels)), PIECE // 5):
            self._client.log_batch(self._run, params=params[i : i + PIECE // 5], tags=labels[i : i + PIECE // 5])


def _library() -> Any:
    """Import MLflow and return its client class."""
    for name, value in SETTINGS.items():
        os.environ.setdefault(name, value)
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
