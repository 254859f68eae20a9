"""`gauntlet profile`: how close a run came to what its episodes usually cost."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.shared import BadInput, newest_run, out
from orchestrator.cli.tables import rich_table
from results.run import RunError, read_run


def profile(
    folder: Annotated[Path | None, typer.Argument(help="Run folder; by default the newest under runs/.")] = None,
) -> None:
    """Worker time of a run: its episodes at median cost, and what the rest was."""
    from results import profile as profiling
    from results.report import ReportPaths
    from results.report.parquet import read_frame
    from results.report.profile import profile_table

    folder = folder or newest_run()
    try:
        read_run(folder)
    except RunError as error:
        raise BadInput(str(error)) from None
    file = ReportPaths.of(folder).episodes
    if not file.exists():
        raise BadInput(f"{folder}: no report yet; write it with: gauntlet report {folder}")
    found = profiling.profile(read_frame(file, profiling.COLUMNS))
    if not found:
        raise BadInput(f"{folder}: expected a run with rows, it has none")
    out.print(rich_table(profile_table(found), title="Worker time after start-up"))
