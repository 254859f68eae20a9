"""Writes a run to MLflow: a server, a database or a folder, as MLFLOW_TRACKING_URI says."""

from __future__ import annotations

import os
import time
from typing import Any
from urllib.parse import urlsplit

from orchestrator.loggers.entry import Entry, LoggingError, check_project, entry_of
from results.report.spreadsheet import render_csv
from results.run import RunDocument, RunStatus
from results.tables import Tables

STATUSES = {
    RunStatus.RUNNING: "RUNNING",
    RunStatus.COMPLETE: "FINISHED",
    RunStatus.INTERRUPTED: "KILLED",
    RunStatus.STOPPED: "FAILED",
}
TAG = "gauntlet_run_id"
"""By which a run that was logged before is found again."""
PIECE = 500
"""MLflow takes a thousand metrics at once, a hundred parameters or tags."""


def log_run(document: RunDocument, tables: Tables, *, name: str, project: str) -> str:
    """Write a run's numbers, provenance and tags, and `cells.csv`. A run that was logged before is written anew.

    The server and the login are MLflow's own settings (MLFLOW_TRACKING_URI and others).

    Args:
        document: Of the run.
        tables: Of the run.
        name: Of the run, for people.
        project: MLflow's experiment; made if there is none.

    Returns:
        Where it is: server, experiment and run, without a login.

    Raises:
        LoggingError: The library is missing, or does not take the run.
    """
    check_project(project)
    entry = entry_of(document, tables)
    make = _library()
    try:
        client = make()
        run = _write(client, document, entry, render_csv(tables), name, project)
        return f"{_shown(client.tracking_uri)}, experiment {project}, run {run}"
    except Exception as error:  # its text may hold the address with a login
        code = getattr(error, "error_code", None)
        trouble = f"{type(error).__name__}{f' {code}' if isinstance(code, str) else ''}"
    raise LoggingError(f"MLflow did not take the run ({trouble}); check MLFLOW_TRACKING_URI, its login and --project")


def _library() -> Any:
    """The class of MLflow's clients."""
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "3")  # by default it tries for minutes
    try:
        import alembic  # noqa: F401  without which a database cannot be one for MLflow, and which skinny leaves out
        from mlflow.tracking import MlflowClient
    except ImportError:
        raise LoggingError('MLflow is not installed; install it with: pip install "robogauntlet[mlflow]"') from None
    return MlflowClient


def _write(client: Any, document: RunDocument, entry: Entry, cells: str, name: str, project: str) -> str:
    from mlflow.entities import Metric, Param, RunTag

    found = client.get_experiment_by_name(project)
    experiment = client.create_experiment(project) if found is None else found.experiment_id
    own = document.run_id.replace("'", "")
    before = client.search_runs([experiment], f"tags.{TAG} = '{own}'", max_results=1)
    started = int(1000 * document.started_at)
    if before:
        run = before[0].info.run_id
    else:
        run = client.create_run(experiment, start_time=started, tags={TAG: own}, run_name=name).info.run_id
    tags = {f"gauntlet/{key}": str(value) for key, value in entry.state.items()} | dict.fromkeys(entry.tags, "yes")
    now = int(1000 * time.time())
    params = [Param(key, str(value)) for key, value in entry.provenance.items()]
    labels = [RunTag(key, value) for key, value in tags.items()]
    metrics = [Metric(key, value, now, 0) for key, value in entry.metrics.items()]
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
    """An address without its login and its options."""
    parts = urlsplit(address)
    return f"{parts.scheme}://{parts.hostname}" if parts.netloc else address.partition("?")[0]
