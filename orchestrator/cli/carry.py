"""`gauntlet export` and `import`: a run as one file, or its episodes as datasets."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack, closing
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orchestrator.cli.shared import (
    EXIT_INTERRUPTED,
    EXIT_STOPPED,
    BadInput,
    HistoryUrl,
    StoreUrl,
    fail,
    history_url,
    open_history,
    out,
    runs_root,
)
from orchestrator.folders import FolderError
from orchestrator.progress import FilmingProgress
from orchestrator.replay import ReplayError, homes_of, policy_sources
from policies.contract import PolicyError
from results import exchange
from results.carrying import export_run, import_run
from results.opening import OpenRun
from results.report.parquet import write_parquet
from results.report.text import counted
from results.run import RunDocument, RunError, RunStatus, read_run
from results.store import Store, StoreError
from results.syncing import take_in_run
from suites.part import NoSuchPart

if TYPE_CHECKING:
    from orchestrator.retelling import Choice


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
    LEROBOT_DATASET = "lerobot-dataset"
    """Episodes, played again and recorded as LeRobot v3 datasets, one per task."""


class Ended(StrEnum):
    """How an episode ended."""

    FAILURE = "failure"
    SUCCESS = "success"


ENDINGS = {
    Form.RUN: ".gauntlet",
    Form.CSV: ".csv",
    Form.PARQUET: ".parquet",
    Form.LEROBOT: "-eval_info.json",
    Form.VLA_EVAL: "-vla_eval.json",
    Form.LEROBOT_DATASET: "-lerobot",
}


def export(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    form: Annotated[
        Form, typer.Option("--format", help="The whole run, its rows as a table, or what other programs read.")
    ] = Form.RUN,
    policy: Annotated[
        str | None, typer.Option(help="Of which policy, for lerobot and vla-eval; for lerobot-dataset also a pattern.")
    ] = None,
    task: Annotated[
        list[str] | None, typer.Option(help="lerobot-dataset: only this task, or pattern. Repeatable.")
    ] = None,
    condition: Annotated[
        list[str] | None,
        typer.Option(help="lerobot-dataset: only this condition (clean, 'noise@*'). Repeatable."),
    ] = None,
    status: Annotated[
        list[Ended] | None,
        typer.Option(help="lerobot-dataset: episodes that ended so; by default failures. Repeatable."),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="lerobot-dataset: at most so many of each task.")] = None,
    file: Annotated[
        Path | None,
        typer.Option("--out", help="The file, or folder of datasets; by default named after the run, here."),
    ] = None,
    store: StoreUrl = None,
) -> None:
    """Write a run into one file: whole, as `gauntlet import` reads it, or in the words of other programs.

    As lerobot-dataset, episodes are played again and recorded, frame by frame, for retraining.
    """
    file = file or Path(f"{run.absolute().name}{ENDINGS[form]}")
    if form is Form.LEROBOT_DATASET:
        from orchestrator.retelling import Choice

        statuses = tuple(map(str, status or (Ended.FAILURE,)))
        policies = () if policy is None else (policy,)
        choice = Choice(policies, tuple(task or ()), tuple(condition or ()), statuses, limit)
        _write_datasets(run, choice, file, store)
        return
    if task or condition or status or limit:
        raise BadInput("expected --task, --condition, --status and --limit with --format lerobot-dataset only")
    if policy is not None and form not in (Form.LEROBOT, Form.VLA_EVAL):
        raise BadInput(f"expected --policy with --format lerobot, vla-eval or lerobot-dataset only, got {form}")
    try:
        document = read_run(run)
        rows = Store.open_begun(run, document, store)
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
        if form is not Form.RUN:
            file.unlink(missing_ok=True)  # it is new, and would stand in the way of the next try
        raise BadInput(f"{file}: cannot be written: {error.strerror or error}") from None
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


def _write_datasets(run: Path, choice: Choice, folder: Path, store: str | None) -> None:
    from orchestrator.retelling import Written, write_datasets

    def listener(written: Written, count: int) -> Callable[[], None]:
        if written.there:
            out.print(f"continuing: {written.there} of {counted(written.wanted, 'episode')} are there already")
        return progress.enter_context(FilmingProgress(out, count, what="playing again")).came

    try:
        document = read_run(run)
        with closing(Store.open_begun(run, document, store)) as rows:
            chosen = choice.of(document, rows.results())
        if not chosen:
            raise BadInput(f"{run}: no episode that was asked for")
        with ExitStack() as progress:
            written = write_datasets(chosen, document, policy_sources(document), folder, listener, homes_of(document))
    except (RunError, StoreError, ReplayError, NoSuchPart, PolicyError, FolderError) as error:
        raise BadInput(str(error)) from None
    for writer in written.writers.values():
        said = f"{writer.folder}: {counted(writer.episodes, 'episode')}, {counted(writer.frames, 'frame')}"
        out.print(said, markup=False, soft_wrap=True)
    for trouble in written.troubles:
        fail(trouble)
    if written.status is RunStatus.INTERRUPTED:
        fail("interrupted; give the same command to continue")
        raise typer.Exit(EXIT_INTERRUPTED)
    if written.troubles:
        raise typer.Exit(EXIT_STOPPED if written.status is RunStatus.STOPPED else 1)


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
    history_url(url)
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
