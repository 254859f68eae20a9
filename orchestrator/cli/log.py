"""`robogauntlet log`: send the results of a run to an experiment tracker."""

from __future__ import annotations

from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import RunArgument, StoreUrl, print_line
from robogauntlet.orchestrator.trackers import PROJECT, TrackerName, open_tracker
from robogauntlet.results.api import open_run


def log(
    run: RunArgument,
    to: Annotated[TrackerName, typer.Option("--to", help="Weights & Biases, or MLflow.")],
    project: Annotated[str, typer.Option(help="Project of W&B, experiment of MLflow.")] = PROJECT,
    store: StoreUrl = None,
) -> None:
    """Send the results of a run to an experiment tracker.

    Success rates, intervals, errors and provenance are sent. A run that was sent before is updated.
    """
    opened = open_run(run, store)
    tables = opened.tables()
    address = open_tracker(to, project).send(opened.document, tables, run.absolute().name)
    print_line(f"logged: {address}")
