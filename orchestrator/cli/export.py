"""`robogauntlet export`: write a run or its rows, or send its results to a tracker."""

from __future__ import annotations

from contextlib import closing
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import RunArgument, StoreUrl, print_line, refuse
from robogauntlet.orchestrator.trackers import PROJECT, TrackerName, open_tracker
from robogauntlet.results.api import OpenRun, open_run
from robogauntlet.results.report.formatting import counted, spreadsheet_cell
from robogauntlet.results.run_document import RunDocument, read_run
from robogauntlet.results.store.arriving import arriving_file
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.episodes_parquet import write_parquet
from robogauntlet.results.store.exported_run import ARCHIVE, export_run
from robogauntlet.support.errors import BadInput


class Format(StrEnum):
    """Format of an exported run."""

    RUN = "run"
    """The whole run, for `robogauntlet import`."""
    CSV = "csv"
    PARQUET = "parquet"


SUFFIXES = {Format.RUN: ARCHIVE, Format.CSV: ".csv", Format.PARQUET: ".parquet"}


def export(
    run: RunArgument,
    form: Annotated[Format, typer.Option("--format", help="The whole run, or its rows as a table.")] = Format.RUN,
    file: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="File to write; by default named after the run. A whole run is an archive if the name ends in "
            f"{ARCHIVE}, else a folder.",
        ),
    ] = None,
    media: Annotated[bool, typer.Option("--media", help="run: with its videos and pictures.")] = False,
    tracker: Annotated[
        TrackerName | None,
        typer.Option(help="Send the results to this experiment tracker instead; what was sent before is updated."),
    ] = None,
    project: Annotated[
        str | None, typer.Option(help=f"With --tracker: project of W&B, experiment of MLflow ({PROJECT}).")
    ] = None,
    store: StoreUrl = None,
) -> None:
    """Write a run as a file or table, or send it to a tracker."""
    if tracker is not None:
        refuse("--tracker", {"--out": file, "--media": media})
        opened = open_run(run, store)
        address = open_tracker(tracker, project or PROJECT).send(opened.document, opened.tables(), run.absolute().name)
        print_line(f"logged: {address}")
        return
    if project is not None:
        raise BadInput("--project: expected with --tracker")
    file = file or Path(f"{run.absolute().name}{SUFFIXES[form]}")
    if media and form is not Format.RUN:
        raise BadInput(f"expected --media with --format run only, got {form}")
    if form is not Format.RUN:
        _check_new(file)
    try:
        document = read_run(run)
        with closing(Store.open_begun(run, document, store)) as rows:
            if form is Format.RUN:
                count = export_run(run, document, rows, file, media=media)
            else:
                with arriving_file(file) as partial:
                    count = _write(form, document, OpenRun(run, document, store), rows, partial)
    except OSError as error:
        raise BadInput(f"{file}: cannot be written: {error.strerror or error}") from None
    print_line(f"{counted(count, 'episode')} into {file}")


def _write(form: Format, document: RunDocument, run: OpenRun, rows: Store, file: Path) -> int:
    if form is Format.PARQUET:
        return write_parquet(file, document, rows)
    table = run.episodes()
    texts = table.select_dtypes(exclude=["number", "bool"])
    table.assign(**{name: texts[name].map(spreadsheet_cell) for name in texts}).to_csv(file, index=False)
    return len(table)


def _check_new(file: Path) -> None:
    """Refuse a file that exists, or a place for one that does not."""
    if file.exists() or file.is_symlink():
        raise BadInput(f"{file}: expected a new file, this one exists")
    if not file.parent.is_dir():
        raise BadInput(f"{file}: expected a file in an existing folder")
