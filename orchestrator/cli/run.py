"""`gauntlet run`: play a suite."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.shared import (
    EXIT_INTERRUPTED,
    EXIT_STOPPED,
    BadInput,
    HistoryUrl,
    Policies,
    SeedCount,
    Tasks,
    fail,
    history_url,
    out,
    plan_of,
)
from orchestrator.cli.tables import print_summary
from orchestrator.folders import FolderError
from orchestrator.plan import PlanError
from orchestrator.probe import probe
from orchestrator.progress import Progress, format_duration
from orchestrator.run import RunOptions, RunOutcome, run_plan
from results.run import RunError, RunStatus
from results.store import StoreError
from suites.part import Part


def run(
    suite: Annotated[str, typer.Argument(help="A suite file, or the name of a shipped suite.")],
    policy: Policies = None,
    task: Tasks = None,
    seeds: SeedCount = None,
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="Run folder. An existing run of the same suite is continued.")
    ] = None,
    require: Annotated[
        list[str] | None, typer.Option("--require", help="Simulator without which nothing is started. Repeatable.")
    ] = None,
    store: Annotated[
        str | None,
        typer.Option(envvar="GAUNTLET_STORE", help="URL of a store for the rows, instead of a file in the run folder."),
    ] = None,
    address: Annotated[str | None, typer.Option(help="Ray cluster to run on, instead of this machine.")] = None,
    retry_errors: Annotated[
        bool, typer.Option("--retry-errors", help="Play episodes again that ended in an error.")
    ] = False,
    media: Annotated[bool, typer.Option(help="Film a success and a failure of each policy on each task.")] = True,
    history: HistoryUrl = None,
    schedule: Annotated[str | None, typer.Option(hidden=True, help="The schedule that begins this run.")] = None,
) -> None:
    """Play a suite, or a part or what is missing of it, and report."""
    required = tuple(require or ())
    plan = plan_of(suite, part=Part(tuple(policy or ()), tuple(task or ()), seeds), only=required)
    broken = [f"{f.simulator}: {f.problem}" for f in probe(required, plan.homes) if f.problem]
    if broken:
        raise BadInput("\n".join(broken))
    folder = out_folder or Path("runs") / f"{plan.suite.name}-{datetime.now():%Y%m%d-%H%M%S}"
    out.print(f"{plan.suite.name}: {plan.episodes} episodes into {folder}", markup=False, soft_wrap=True)
    for name, reason in plan.unavailable.items():
        fail(f"{name} is skipped: {reason}")
    known = store if history is None and store is not None else history_url(history, folder.parent)
    options = RunOptions(store, address, retry_errors, media, known, schedule)
    try:
        outcome = run_plan(plan, folder, options, Progress(out))
    except (PlanError, FolderError, RunError, StoreError) as error:
        raise BadInput(str(error)) from None
    _conclude(outcome)


def _conclude(outcome: RunOutcome) -> None:
    document = outcome.document
    print_summary(outcome.folder)
    for trouble in outcome.troubles:
        fail(trouble)
    out.print(f"{outcome.done} of {document.planned} episodes in {format_duration(document.elapsed_s)}", end="")
    out.print(f", rows hash {document.rows_hash}" if document.rows_hash else "")
    out.print(f"report: {outcome.folder / 'report.html'}", markup=False, soft_wrap=True)
    again = f"continue with: gauntlet run {document.suite_path} --out {outcome.folder}"
    if document.status is RunStatus.INTERRUPTED:
        fail(f"interrupted; {again}")
        raise typer.Exit(EXIT_INTERRUPTED)
    if document.status is RunStatus.STOPPED:
        fail(f"stopped: {document.reason}")
        fail(again)
        raise typer.Exit(EXIT_STOPPED)
