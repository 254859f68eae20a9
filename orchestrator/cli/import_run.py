"""`robogauntlet import`: create a run folder from an exported run."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import INPUT_ERRORS, HistoryUrl, open_history, print_line, runs_root
from robogauntlet.results.report.formatting import counted
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store import exported_run
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import history_url
from robogauntlet.support.errors import BadInput, describe, describe_os_error


def import_run(
    file: Annotated[Path, typer.Argument(help="A file or folder that `robogauntlet export` wrote.")],
    folder: Annotated[Path | None, typer.Option("--out", help="New run folder; by default under runs/.")] = None,
    url: HistoryUrl = None,
) -> None:
    """Create a run folder from an exported run.

    The report is written, and the run is recorded in the history.
    """
    from robogauntlet.results.report import write_report

    if folder is not None and folder.name in ("", ".."):  # pathlib has no name for '' and '.'
        raise BadInput(f"--out: expected the name of a new folder, got '{folder}'")
    root = folder.absolute().parent if folder else runs_root(url)
    history_url(url, root)  # a wrong URL is refused before anything is written

    def check(document: RunDocument) -> None:
        with open_history(url) as history:
            known = history.find(document.run_id)
        if known is not None and known.run_id == document.run_id:
            place = known.folder or "a folder that is gone"
            run = f"run {document.run_id}"
            raise BadInput(f"{file}: {run} is in the history already, in {place}; nothing is imported")

    try:
        run, document = exported_run.import_run(file, root, name=folder.name if folder else None, check=check)
        try:
            write_report(run)
            with open_history(url) as history:
                record_run_folder(history, run, document)
        except BaseException as error:
            shutil.rmtree(run, ignore_errors=True)
            if not isinstance(error, Exception) or isinstance(error, (*INPUT_ERRORS, OSError)):
                raise
            raise BadInput(f"{file}: expected a run with a report, it cannot be made: {describe(error)}") from error
    except OSError as error:
        raise BadInput(f"{root}: cannot be written: {describe_os_error(error)}") from None
    print_line(f"{counted(document.planned, 'planned episode')} of {document.suite.name} in {run}")
    print_line(f"report: {run / 'report.html'}")
