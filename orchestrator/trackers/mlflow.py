"""Sends a run to MLflow: a server, a database or a folder, as set by MLFLOW_TRACKING_URI."""

from __future__ import annotations

import os
import time
from typing import Any
from urllib.parse import urlsplit

from robogauntlet.orchestrator.trackers.tracked_run import TrackedRun, TrackerError, check_project, tracked_run
from robogauntlet.results.analysis.tables import Tables
from robogauntlet.results.report.summary import render_csv
from robogauntlet.results.run_document import RunDocument, RunStatus

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


def log_run(document: RunDocument, tables: Tables, *, name: str, project: str) -> str:
    """Send numbers, provenance, tags and `cells.csv` of a run to the MLflow experiment `project`, which may be new.

    Server and login are MLflow's own settings (MLFLOW_TRACKING_URI and others).

    Returns:
        Server, experiment and id of the run, without a login.
    """
    check_project(project)
    summary = tracked_run(document, tables)
    client_class = _library()
    try:
        client = client_class()
        run = _write(client, document, summary, render_csv(tables), name, project)
        return f"{_shown(client.tracking_uri)}, experiment {project}, run {run}"
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


def _write(client: Any, document: RunDocument, summary: TrackedRun, cells: str, name: str, project: str) -> str:
    from mlflow.entities import Metric, Param, RunTag

    known = client.get_experiment_by_name(project)
    experiment = client.create_experiment(project) if known is None else known.experiment_id
    run_id = document.run_id.replace("'", "")
    earlier = client.search_runs([experiment], f"tags.{TAG} = '{run_id}'", max_results=1)
    started = int(1000 * document.started_at)
    if earlier:
        run = earlier[0].info.run_id
    else:
        run = client.create_run(experiment, start_time=started, tags={TAG: run_id}, run_name=name).info.run_id
    now = int(1000 * time.time())
    params = [Param(key, str(value)) for key, value in summary.provenance.items()]
    labels = [RunTag(f"robogauntlet/{key}", str(value)) for key, value in summary.state.items()]
    labels += [RunTag(tag, "yes") for tag in summary.tags]
    metrics = [Metric(key, value, now, 0) for key, value in summary.metrics.items()]
    for i in range(0, max(len(params), len(labels)), PIECE // 5):
        client.log_batch(run, params=params[i : i + PIECE // 5], tags=labels[i : i + PIECE // 5])
    for i in range(0, len(metrics), PIECE):
        client.log_batch(run, metrics=metrics[i : i + PIECE])
    client.log_text(run, cells, "cells.csv")
    if document.status is RunStatus.RUNNING:
        client.update_run(run, status=STATUSES[document.status])
    else:
        ended = document.finished_at or document.started_at + document.elapsed_s
        client.set_terminated(run, STATUSES[document.status], int(1000 * ended))
    return str(run)


def _shown(address: str) -> str:
    """The address without login and options."""
    parts = urlsplit(address)
    return f"{parts.scheme}://{parts.hostname}" if parts.netloc else address.partition("?")[0]
