"""`robogauntlet accept`: make a run the baseline of later runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import HistoryUrl, open_history, print_line
from robogauntlet.results.store.run_history import SHORTEST_ID
from robogauntlet.support.errors import BadInput


def accept(
    run: Annotated[str, typer.Argument(help=f"Name of a run's folder, or {SHORTEST_ID} or more characters of its id.")],
    url: HistoryUrl = None,
) -> None:
    """Make a run the baseline of later runs.

    Use it for a run that is correct although it was found worse than its baseline or not comparable with it.
    """
    with open_history(url) as history:
        entry = history.find(Path(run).name)
        if entry is None:
            raise BadInput(f"no run '{run}' in the history; see: robogauntlet history")
        if entry.imported:
            raise BadInput(f"{entry.name}: a run of others is no baseline; run its suite file: robogauntlet run SUITE")
        history.accept(entry.run_id)
    print_line(f"{entry.name}: later runs of {entry.suite} are compared with it")
