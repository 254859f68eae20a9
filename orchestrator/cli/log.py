"""`gauntlet log`: write a run's numbers into an experiment logger."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.shared import BadInput, StoreUrl, out
from results.opening import open_run
from results.run import RunError
from results.store import StoreError


class Logger(StrEnum):
    """Where a run can be logged."""

    WANDB = "wandb"
    MLFLOW = "mlflow"


def log(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    to: Annotated[Logger, typer.Option("--to", help="Weights & Biases, or MLflow.")],
    project: Annotated[str, typer.Option(help="W&B's project, MLflow's experiment.")] = "robogauntlet",
    store: StoreUrl = None,
) -> None:
    """Write a run's success rates, intervals, errors and provenance to Weights & Biases or MLflow."""
    from orchestrator.loggers import LoggingError, mlflow, wandb

    log_run = {Logger.WANDB: wandb.log_run, Logger.MLFLOW: mlflow.log_run}[to]
    try:
        opened = open_run(run, store)
        where = log_run(opened.document, opened.tables(), name=run.absolute().name, project=project)
    except (RunError, StoreError, LoggingError) as error:
        raise BadInput(str(error)) from None
    out.print(f"logged: {where}", markup=False, soft_wrap=True)
