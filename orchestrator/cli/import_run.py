"""`robogauntlet import`: create a run folder from an exported run, or from result files of others."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import INPUT_ERRORS, HistoryUrl, open_history, print_line, runs_root
from robogauntlet.results.report.formatting import counted
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store import exported_run
from robogauntlet.results.store.foreign.files import is_foreign, read_files
from robogauntlet.results.store.foreign.run import import_results
from robogauntlet.results.store.foreign.trials import BadResults
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import history_url
from robogauntlet.suites.schema import valid_name
from robogauntlet.support.errors import BadInput, describe, describe_os_error

Importer = Callable[[Path, Callable[[RunDocument], None]], tuple[Path, RunDocument]]
"""Makes a run folder under a root; calls back with the document before."""


def import_run(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="A file or folder that `robogauntlet export` wrote, or result files of others: a CSV of "
            "trials, eval_info.json of lerobot-eval, *_aggregate.json of vla-eval.",
        ),
    ],
    name: Annotated[
        str | None, typer.Option("--name", help="Result files: suite that lists the run; by default the file's name.")
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option("--policy", help="Result files: the policy of a file that does not name it, in their order."),
    ] = None,
    task: Annotated[
        str | None, typer.Option("--task", help="Result files: the task of files that do not name it.")
    ] = None,
    paired: Annotated[
        bool,
        typer.Option(
            "--paired", help="Result files: trials of one task and number start from the same state for every policy."
        ),
    ] = False,
    folder: Annotated[Path | None, typer.Option("--out", help="New run folder; by default under runs/.")] = None,
    url: HistoryUrl = None,
) -> None:
    """Create a run folder from an exported run, or from result files of others.

    The report is written, and the run is recorded in the history.
    """
    if folder is not None and folder.name in ("", ".."):  # pathlib has no name for '' and '.'
        raise BadInput(f"--out: expected the name of a new folder, got '{folder}'")
    new = folder.name if folder else None
    if all(map(is_foreign, files)):
        results = read_files(files, policy or [], task=task, paired=paired)
        for note in results.notes:
            print_line(note)
        suite = valid_name(files[0].stem if name is None else name)
        if not suite:
            raise BadInput(f"--name: expected a name with a letter or digit, got '{name or files[0].stem}'")

        def make(root: Path, check: Callable[[RunDocument], None]) -> tuple[Path, RunDocument]:
            try:
                return import_results(results, files, root, suite=suite, name=new, check=check)
            except BadResults as error:
                raise BadInput(f"{files[0]}: {error}") from None
    else:
        given = {"--name": name, "--policy": policy, "--task": task, "--paired": paired}
        if named := next((option for option, value in given.items() if value), None):
            raise BadInput(f"{named}: expected with result files of others, not with an exported run")
        if len(files) > 1:
            raise BadInput(f"expected one exported run, or result files of others, got {len(files)} files")

        def make(root: Path, check: Callable[[RunDocument], None]) -> tuple[Path, RunDocument]:
            return exported_run.import_run(files[0], root, name=new, check=check)

    _import(files[0], make, folder.absolute().parent if folder else runs_root(url), url)


def _import(file: Path, make: Importer, root: Path, url: str | None) -> None:
    """Make the run, write its report and record it. What fails leaves nothing behind."""
    from robogauntlet.results.report import write_report

    history_url(url, root)  # a wrong URL is refused before anything is written

    def check(document: RunDocument) -> None:
        with open_history(url) as history:
            known = history.find(document.run_id)
        if known is not None and known.run_id == document.run_id:
            place = known.folder or "a folder that is gone"
            run = f"run {document.run_id}"
            raise BadInput(f"{file}: {run} is in the history already, in {place}; nothing is imported")

    try:
        run, document = make(root, check)
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
