"""`robogauntlet log`: send the results of a run to an experiment tracker."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import BadInput, RunArgument, StoreUrl, print_line
from robogauntlet.results.api import open_run
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.episode_store import StoreError


class Tracker(StrEnum):
    """An experiment tracker."""

    WANDB = "wandb"
    MLFLOW = "mlflow"


def log(
    run: RunArgument,
    to: Annotated[Tracker, typer.Option("--to", help="Weights & Biases, or MLflow.")],
    project: Annotated[str, typer.Option(help="Project of W&B, experiment of MLflow.")] = "robogauntlet",
    store: StoreUrl = None,
) -> None:
    """Send the results of a run to an experiment tracker.

    Success rates, intervals, errors and provenance are sent. A run that was sent before is updated.
    """
    from robogauntlet.orchestrator.trackers import TrackerError, mlflow, wandb

    log_run = {Tracker.WANDB: wandb.log_run, Tracker.MLFLOW: mlflow.log_run}[to]
    try:
        opened = open_run(run, store)
        address = log_run(opened.document, opened.tables(), name=run.absolute().name, project=project)
    except (RunError, StoreError, TrackerError) as error:
        raise BadInput(str(error)) from None
    print_line(f"logged: {address}")
