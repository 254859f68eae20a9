"""`gauntlet run`: play a suite."""

from __future__ import annotations

import os
import shlex
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
from orchestrator.cluster import NoCluster, check_address
from orchestrator.folders import FolderError
from orchestrator.plan import PlanError
from orchestrator.probe import probe
from orchestrator.progress import Progress, format_duration
from orchestrator.run import RunOptions, RunOutcome, run_plan
from results.database import without_password
from results.run import RunError, RunStatus
from results.store import StoreError
from suites.part import Part

STORE_VARIABLE = "GAUNTLET_STORE"


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
        typer.Option(envvar=STORE_VARIABLE, help="URL of a store for the rows, instead of a file in the run folder."),
    ] = None,
    address: Annotated[
        str | None,
        typer.Option(
            help="Ray cluster to run on instead of this machine: HOST:PORT of its head, or auto for one that runs here."
        ),
    ] = None,
    retry_errors: Annotated[
        bool, typer.Option("--retry-errors", help="Play episodes again that ended in an error.")
    ] = False,
    media: Annotated[bool, typer.Option(help="Film a success and a failure of each policy on each task.")] = True,
    history: HistoryUrl = None,
    schedule: Annotated[str | None, typer.Option(hidden=True, help="The schedule that begins this run.")] = None,
) -> None:
    """Play a suite, or a part or what is missing of it, and report."""
    required = tuple(require or ())
    part = Part(tuple(policy or ()), tuple(task or ()), seeds)
    plan = plan_of(suite, part=part, only=required)
    broken = [f"{f.simulator}: {f.problem}" for f in probe(required, plan.homes) if f.problem]
    if broken:
        raise BadInput("\n".join(broken))
    if address is not None:
        try:
            check_address(address)
        except NoCluster as error:
            raise BadInput(f"--address {address}: {error}") from None
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
    _conclude(outcome, _again(outcome, part, store, address))


def _again(outcome: RunOutcome, part: Part, store: str | None, address: str | None) -> str:
    """The command that continues a run: what was left out of the suite has to be left out again."""
    words = ["gauntlet", "run", outcome.document.suite_path]
    words += [word for name in part.policies for word in ("--policy", name)]
    words += [word for name in part.tasks for word in ("--task", name)]
    words += [] if part.seeds is None else ["--seeds", str(part.seeds)]
    words += ["--out", str(outcome.folder)]
    words += ["--store", without_password(store)] if store is not None and STORE_VARIABLE not in os.environ else []
    words += ["--address", address] if address is not None else []
    return shlex.join(words)


def _conclude(outcome: RunOutcome, command: str) -> None:
    document = outcome.document
    print_summary(outcome.folder)
    for trouble in outcome.troubles:
        fail(trouble)
    out.print(f"{outcome.done} of {document.planned} episodes in {format_duration(document.elapsed_s)}", end="")
    out.print(f", rows hash {document.rows_hash}" if document.rows_hash else "")
    out.print(f"report: {outcome.folder / 'report.html'}", markup=False, soft_wrap=True)
    again = f"continue with: {command}"
    if document.status is RunStatus.INTERRUPTED:
        fail(f"interrupted; {again}")
        raise typer.Exit(EXIT_INTERRUPTED)
    if document.status is RunStatus.STOPPED:
        fail(f"stopped: {document.reason}")
        fail(again)
        raise typer.Exit(EXIT_STOPPED)
