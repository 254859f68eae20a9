"""`gauntlet report`: write a run's report again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.shared import BadInput, StoreUrl, newest_run, out
from orchestrator.cli.tables import print_summary
from results.run import RunError
from results.store import StoreError


def report(
    folder: Annotated[Path | None, typer.Argument(help="Run folder; by default the newest under runs/.")] = None,
    store: StoreUrl = None,
    video_mb: Annotated[
        float | None, typer.Option(min=0, max=1000, help="Megabytes of video in report.html at most; by default 9.")
    ] = None,
) -> None:
    """Write report.html, report.md, summary.json and episodes.parquet of a run."""
    from results.report import write_report

    folder = folder or newest_run()
    budget = {} if video_mb is None else {"video_budget": int(1e6 * video_mb)}
    try:
        paths = write_report(folder, store_url=store, **budget)
    except (RunError, StoreError) as error:
        raise BadInput(str(error)) from None
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written: {error.strerror}") from None
    print_summary(folder)
    out.print(f"report: {paths.html}", markup=False, soft_wrap=True)
