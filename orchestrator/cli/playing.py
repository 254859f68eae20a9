"""Plays a plan into a folder and prints its numbers: what `run` and `resume` have in common."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

import typer

from robogauntlet.orchestrator.cli.common import EXIT_INTERRUPTED, EXIT_STOPPED, fail, out, print_line
from robogauntlet.orchestrator.cli.console_tables import print_summary
from robogauntlet.orchestrator.environments.probe import probe
from robogauntlet.orchestrator.episodes.policy_source import given_variables
from robogauntlet.orchestrator.ray_runtime.cluster import NoCluster, check_address
from robogauntlet.orchestrator.runs.history_observer import HistoryObserver
from robogauntlet.orchestrator.runs.observer import Observer, RunState
from robogauntlet.orchestrator.runs.plan import Plan, check_same, fitted
from robogauntlet.orchestrator.runs.progress_display import ProgressDisplay
from robogauntlet.orchestrator.runs.run import RunOptions, run_plan
from robogauntlet.orchestrator.schedules.schedule import SCHEDULE_VARIABLE
from robogauntlet.orchestrator.trackers import Tracker
from robogauntlet.results.run_document import RUN_FILE, RunArguments, RunStatus, read_run
from robogauntlet.results.store.run_history import history_url
from robogauntlet.support.durations import format_duration
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import counted


def play_plan(
    plan: Plan,
    folder: Path,
    given: RunArguments,
    *,
    store: str | None,
    history: str | None,
    tracker: Tracker | None,
    verbose: bool,
) -> None:
    """Play the missing episodes of a plan into a folder, print its numbers, and exit with the code of its end.

    Args:
        plan: The plan.
        folder: The run folder.
        given: What the run document keeps for `resume`.
        store: URL of the store, with its password, if it is not in the folder.
        history: URL of the history, with its password, if it is not beside the folder.
        tracker: An experiment tracker that observes the run.
        verbose: Print a line for each episode.

    Raises:
        BadInput: A required simulator does not work, or the cluster cannot be reached.
        PlanError: The folder holds another run.
    """
    broken = [f"{f.simulator}: {f.problem}" for f in probe(given.require, plan.environments) if f.problem]
    if broken:
        raise BadInput("\n".join(broken))
    if given.address is not None:
        try:
            check_address(given.address)
        except NoCluster as error:
            raise BadInput(f"--address {given.address}: {error}") from None
    if (folder / RUN_FILE).exists():
        check_same(plan, read_run(folder), folder)
    print_line(f"{plan.suite.name}: {counted(plan.episodes, 'episode')} into {folder}")
    for line in (*fitted(plan), *given_variables(plan.sources)):
        print_line(line)
    for warning in plan.warnings:
        fail(warning)
    for name, reason in plan.unavailable.items():
        fail(f"{name} is skipped: {reason}")
    history_store = store if history is None and store is not None else history_url(history, folder.absolute().parent)
    schedule = os.environ.get(SCHEDULE_VARIABLE)
    options = RunOptions(
        store,
        given.address,
        given.retry_errors,
        given.media,
        schedule,
        command=shlex.join(["robogauntlet", "resume", str(folder)]),
        arguments=given,
    )
    numbers = _Numbers()
    observers = [ProgressDisplay(out, verbose=verbose), numbers, HistoryObserver(history_store, folder, schedule)]
    outcome = run_plan(plan, folder, options, [*observers, *([tracker] if tracker else [])])
    for warning in outcome.warnings:
        if warning not in numbers.warnings:
            fail(warning)
    _conclude(outcome)


class _Numbers(Observer):
    """Prints the numbers of a run."""

    warnings: tuple[str, ...] = ()
    """Those that are printed with them."""

    def on_numbers(self, run: RunState) -> None:
        """Print them."""
        document, self.warnings = run.document, tuple(run.warnings)
        if run.report is not None:
            print_summary(run.report)
        for warning in self.warnings:
            fail(warning)
        planned, duration = counted(document.planned, "episode"), format_duration(document.elapsed_s)
        unread = f"the rows cannot be read; {planned} planned, played for {duration}"
        out.print(unread if run.done is None else f"{run.done:,} of {planned} in {duration}", end="")
        out.print(f", rows hash {document.rows_hash}" if document.rows_hash else "")
        if run.report is not None:
            print_line(f"report: {run.report.paths.html}")


def _conclude(outcome: RunState) -> None:
    document, command = outcome.document, outcome.document.command
    if document.media_left_out and not outcome.media_interrupted:
        print_line(
            f"not recorded: {counted(document.media_left_out, 'video or snapshot', 'videos and snapshots')}; "
            f"to record all: {command} --media"
        )
    if outcome.media_interrupted or document.status is RunStatus.INTERRUPTED:
        fail(f"interrupted; continue with: {command}")
        raise typer.Exit(EXIT_INTERRUPTED)
    if document.status is RunStatus.STOPPED:
        fail(f"stopped: {document.reason}")
        fail(f"continue with: {command}")
        raise typer.Exit(EXIT_STOPPED)
