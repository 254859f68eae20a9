"""`gauntlet export` and `import`: a run as one file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.shared import BadInput, HistoryUrl, StoreUrl, open_history, out, runs_root
from results.carrying import export_run, import_run
from results.report.text import counted
from results.run import RunError, read_run, store_url
from results.store import Store, StoreError
from results.syncing import take_in_run


def export(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    file: Annotated[Path | None, typer.Option("--out", help="The file; by default NAME.gauntlet here.")] = None,
    store: StoreUrl = None,
) -> None:
    """Write a run, its document and all its rows, into one file that `gauntlet import` reads."""
    file = file or Path(f"{run.absolute().name}.gauntlet")
    try:
        document = read_run(run)
        rows = Store.open(store_url(run, document, store), document.run_id)
        try:
            count = export_run(document, rows, file)
        finally:
            rows.close()
    except (RunError, StoreError) as error:
        raise BadInput(str(error)) from None
    except OSError as error:
        raise BadInput(f"{file}: cannot be written: {error.strerror}") from None
    out.print(f"{counted(count, 'episode')} into {file}", markup=False, soft_wrap=True)


def take(
    file: Annotated[Path, typer.Argument(help="What `gauntlet export` wrote.")],
    folder: Annotated[Path | None, typer.Option("--out", help="The new run folder; by default under runs/.")] = None,
    store: Annotated[str | None, typer.Option(help="URL of a store for the rows, instead of the folder.")] = None,
    url: HistoryUrl = None,
) -> None:
    """Make a run folder of an exported run, with its report, and tell the history of it."""
    from results.report import write_report

    root = folder.absolute().parent if folder else runs_root(url)
    try:
        made, document = import_run(file, root, store=store, name=folder.name if folder else None)
        write_report(made, store_url=store)
        with open_history(url) as history:
            take_in_run(history, made, document)
    except (RunError, StoreError) as error:
        raise BadInput(str(error)) from None
    except OSError as error:
        raise BadInput(f"{root}: cannot be written: {error.strerror}") from None
    out.print(f"{counted(document.planned, 'planned episode')} of {document.suite_name} in {made}", markup=False)
    out.print(f"report: {made / 'report.html'}", markup=False, soft_wrap=True)
