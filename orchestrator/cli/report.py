"""`robogauntlet report`: write the report of a run again."""

from __future__ import annotations

from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import NewestRunArgument, StoreUrl, newest_run, print_line
from robogauntlet.orchestrator.cli.console_tables import print_summary
from robogauntlet.support.errors import BadInput


def report(
    folder: NewestRunArgument = None,
    store: StoreUrl = None,
    video_mb: Annotated[
        float | None,
        typer.Option(min=0, max=1000, help="Largest size of all videos in report.html (MB); by default 9."),
    ] = None,
) -> None:
    """Write the report of a run again.

    The report consists of report.html, report.md, summary.json, cells.csv and episodes.parquet, and of
    explore.html for perturbed conditions.
    """
    from robogauntlet.results.report import write_report

    folder = folder or newest_run()
    budget = {} if video_mb is None else {"video_budget": int(1e6 * video_mb)}
    try:
        written = write_report(folder, store_url=store, **budget)
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written: {error.strerror}") from None
    print_summary(written)
    print_line(f"report: {written.paths.html}")
