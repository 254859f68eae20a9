"""`gauntlet export` and `import`: a run as one file."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.shared import BadInput, HistoryUrl, StoreUrl, open_history, out, runs_root
from results import exchange
from results.carrying import export_run, import_run
from results.opening import OpenRun
from results.report.parquet import write_parquet
from results.report.text import counted
from results.run import RunDocument, RunError, read_run, store_url
from results.store import Store, StoreError
from results.syncing import take_in_run


class Form(StrEnum):
    """What a run is written as."""

    RUN = "run"
    """Whole, for `gauntlet import`."""
    CSV = "csv"
    PARQUET = "parquet"
    LEROBOT = "lerobot"
    """LeRobot's eval_info.json."""
    VLA_EVAL = "vla-eval"
    """The result file of vla-evaluation-harness."""


ENDINGS = {
    Form.RUN: ".gauntlet",
    Form.CSV: ".csv",
    Form.PARQUET: ".parquet",
    Form.LEROBOT: "-eval_info.json",
    Form.VLA_EVAL: "-vla_eval.json",
}


def export(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    form: Annotated[
        Form, typer.Option("--format", help="The whole run, its rows as a table, or what other programs read.")
    ] = Form.RUN,
    policy: Annotated[str | None, typer.Option(help="Of which policy, for lerobot and vla-eval.")] = None,
    file: Annotated[Path | None, typer.Option("--out", help="The file; by default named after the run, here.")] = None,
    store: StoreUrl = None,
) -> None:
    """Write a run into one file: whole, as `gauntlet import` reads it, or in the words of other programs."""
    file = file or Path(f"{run.absolute().name}{ENDINGS[form]}")
    try:
        document = read_run(run)
        rows = Store.open(store_url(run, document, store), document.run_id)
        try:
            if form is Form.RUN:
                count = export_run(document, rows, file)
            elif form is Form.PARQUET:
                write_parquet(_new(file), document, rows)
                count = sum(rows.status_counts().values())
            else:
                count = _write(form, document, OpenRun(run, document, store), _new(file), policy)
        finally:
            rows.close()
    except (RunError, StoreError) as error:
        raise BadInput(str(error)) from None
    except OSError as error:
        raise BadInput(f"{file}: cannot be written: {error.strerror}") from None
    out.print(f"{counted(count, 'episode')} into {file}", markup=False, soft_wrap=True)


def _write(form: Form, document: RunDocument, run: OpenRun, file: Path, policy: str | None) -> int:
    if form is Form.CSV:
        table = run.episodes()
        table.to_csv(file, index=False)
        return len(table)
    rows = exchange.of_policy(run.episodes(exchange.COLUMNS), policy)
    made = {Form.LEROBOT: exchange.lerobot, Form.VLA_EVAL: exchange.vla_eval}[form](document, rows)
    file.write_text(json.dumps(made, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return len(rows)


def _new(file: Path) -> Path:
    if file.exists():
        raise RunError(f"{file}: expected a new file, there is one already")
    return file


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
