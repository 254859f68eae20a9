"""`robogauntlet run`: run a suite."""

from __future__ import annotations

import os
import shlex
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.adapters.catalog import simulators
from robogauntlet.orchestrator.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_STOPPED,
    HistoryUrl,
    ImageSizeSetting,
    Policies,
    PolicyOptions,
    RenderProfileSetting,
    ReplanEvery,
    SeedCount,
    Success,
    Tasks,
    WorkersSetting,
    fail,
    out,
    print_line,
    suite_settings,
)
from robogauntlet.orchestrator.cli.console_tables import print_summary
from robogauntlet.orchestrator.environments.probe import probe
from robogauntlet.orchestrator.episodes.policy_source import given_variables
from robogauntlet.orchestrator.ray_runtime.cluster import NoCluster, check_address
from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.orchestrator.runs.composition import compose_plan, new_run_folder
from robogauntlet.orchestrator.runs.history_observer import HistoryObserver
from robogauntlet.orchestrator.runs.observer import Observer, RunState
from robogauntlet.orchestrator.runs.plan import check_same, fitted, make_plan
from robogauntlet.orchestrator.runs.progress_display import ProgressDisplay
from robogauntlet.orchestrator.runs.run import RunOptions, run_plan
from robogauntlet.orchestrator.schedules.schedule import SCHEDULE_VARIABLE
from robogauntlet.orchestrator.trackers import PROJECT, open_tracker
from robogauntlet.policies.references import option_text, read_options, read_reference, with_options
from robogauntlet.results.run_document import RUN_FILE, RunStatus, read_run
from robogauntlet.results.run_owner import is_own
from robogauntlet.results.store.database import without_password
from robogauntlet.results.store.run_history import history_url
from robogauntlet.suites.selection import SuiteSelection, option_of
from robogauntlet.support.durations import format_duration
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import counted

STORE_VARIABLE = "ROBOGAUNTLET_STORE"


def run(
    suite: Annotated[
        str | None,
        typer.Argument(help="A suite file or the name of a shipped suite; SIMULATOR/TASK is played by --policy."),
    ] = None,
    policy: Policies = None,
    option: PolicyOptions = None,
    task: Tasks = None,
    seeds: SeedCount = None,
    condition: Annotated[
        list[str] | None,
        typer.Option(
            "--condition",
            help="Without a suite: AXIS or AXIS@SEVERITY[,SEVERITY], beside the clean condition. Repeatable.",
        ),
    ] = None,
    success: Success = None,
    image_size: ImageSizeSetting = None,
    replan_every: ReplanEvery = None,
    render_profile: RenderProfileSetting = None,
    workers: WorkersSetting = None,
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="Run folder; a run of the same suite that is in it is continued.")
    ] = None,
    require: Annotated[
        list[str] | None, typer.Option("--require", help="Start nothing unless this simulator works. Repeatable.")
    ] = None,
    store: Annotated[
        str | None,
        typer.Option(envvar=STORE_VARIABLE, help="URL of a store for the rows, instead of a file in the run folder."),
    ] = None,
    address: Annotated[
        str | None,
        typer.Option(
            help="Ray cluster to run on instead of this machine: HOST:PORT of its head, or auto for a running one."
        ),
    ] = None,
    retry_errors: Annotated[
        bool, typer.Option("--retry-errors", help="Play the episodes again that ended in an error.")
    ] = False,
    media: Annotated[
        bool | None,
        typer.Option(
            help="Record videos of successes and failures: all, or none; by default a failure of each policy and those "
            "for which a fifth of the playing time is enough, after the report is written.",
            show_default=False,
        ),
    ] = None,
    history: HistoryUrl = None,
    log: Annotated[
        str | None,
        typer.Option(
            metavar="[wandb|mlflow]",
            help="Send progress, results and videos to an experiment tracker while the run plays.",
        ),
    ] = None,
    log_project: Annotated[
        str, typer.Option("--log-project", help="With --log: project of W&B, experiment of MLflow.")
    ] = PROJECT,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print a line for each episode.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but problems.")] = False,
) -> None:
    """Run a suite, or continue a run, and write its report.

    In a folder with a run of the suite, only the missing episodes are played. Without a suite, one is composed of
    --policy, --task, --seeds (20 by default) and --condition, and written into the run folder.
    """
    out.quiet = quiet or out.quiet
    required = tuple(require or ())
    trackers = [] if log is None else [open_tracker(log, log_project, print_line)]
    policy_options, part = read_options(option or ()), SuiteSelection()
    settings = suite_settings(success, image_size, replan_every, render_profile, workers)
    if suite is not None and _is_task(suite):
        task, suite = [suite, *(task or ())], None
    if suite is None:
        missing = [name for name, given in (("--policy", policy), ("--task", task)) if not given]
        if missing:
            raise BadInput(f"expected a suite, or --policy and --task; got no {' and no '.join(missing)}")
        plan, folder = compose_plan(
            with_options([read_reference(text) for text in policy or ()], policy_options),
            task or (),
            seeds=seeds,
            conditions=condition or (),
            folder=out_folder,
            only=required,
            settings=settings,
        )
    elif condition:
        raise BadInput(
            "--condition: expected --policy and --task instead of a suite file, which lists its own conditions"
        )
    else:
        _refuse_run_folder(suite)
        part = SuiteSelection(tuple(policy or ()), tuple(task or ()), seeds, policy_options, settings)
        plan = make_plan(find_suite(suite), part=part, only=required)
        folder = out_folder or new_run_folder(plan.suite.name)
    broken = [f"{f.simulator}: {f.problem}" for f in probe(required, plan.environments) if f.problem]
    if broken:
        raise BadInput("\n".join(broken))
    if address is not None:
        try:
            check_address(address)
        except NoCluster as error:
            raise BadInput(f"--address {address}: {error}") from None
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
    command = _command(plan.path, folder, part, store, address)
    if log is not None:
        command += f" --log {log}" + ("" if log_project == PROJECT else f" --log-project {shlex.quote(log_project)}")
    schedule = os.environ.get(SCHEDULE_VARIABLE)
    options = RunOptions(store, address, retry_errors, media, schedule, command)
    numbers = _Numbers()
    observers = [ProgressDisplay(out, verbose=verbose), numbers, HistoryObserver(history_store, folder, schedule)]
    outcome = run_plan(plan, folder, options, [*observers, *trackers])
    for warning in outcome.warnings:
        if warning not in numbers.warnings:
            fail(warning)
    _conclude(outcome, command, command + {None: "", True: " --media", False: " --no-media"}[media])


def _refuse_run_folder(suite: str) -> None:
    """Refuse a run folder in place of a suite, with the command that continues the run."""
    folder = Path(suite)
    if folder.is_dir() and (folder / RUN_FILE).exists():
        document = read_run(folder)
        command = document.command if is_own(folder, document) else None
        command = command or shlex.join(["robogauntlet", "run", document.suite_path, "--out", suite])
        raise BadInput(f"{suite}: expected a suite file, this is a run folder; to continue its run: {command}")


def _is_task(text: str) -> bool:
    simulator, slash, _ = text.partition("/")
    mistyped = not Path(text).suffix and get_close_matches(simulator, simulators(), n=1, cutoff=0.8)
    return bool(slash) and not Path(text).exists() and bool(simulator in simulators() or mistyped)


def _command(path: Path, folder: Path, part: SuiteSelection, store: str | None, address: str | None) -> str:
    """The command that continues a run, with the same part of the suite."""
    arguments = ["robogauntlet", "run", str(path)]
    arguments += [argument for name in part.policies for argument in ("--policy", name)]
    for name, value in part.options.items():
        arguments += ["--option", option_text(name, value)]
    arguments += [argument for name in part.tasks for argument in ("--task", name)]
    arguments += [] if part.seeds is None else ["--seeds", str(part.seeds)]
    for name, value in part.settings.items():
        arguments += [option_of(name), str(value)]
    arguments += ["--out", str(folder)]
    arguments += ["--store", without_password(store)] if store is not None and STORE_VARIABLE not in os.environ else []
    arguments += ["--address", address] if address is not None else []
    return shlex.join(arguments)


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


def _conclude(outcome: RunState, command: str, continuing: str) -> None:
    document = outcome.document
    if document.command is not None and document.command != command:  # it continues elsewhere
        command, continuing = document.command, document.command + continuing.removeprefix(command)
    if document.media_left_out and not outcome.media_interrupted:
        print_line(
            f"not recorded: {counted(document.media_left_out, 'video or snapshot', 'videos and snapshots')}; "
            f"to record all: {command} --media"
        )
    if outcome.media_interrupted or document.status is RunStatus.INTERRUPTED:
        fail(f"interrupted; continue with: {continuing}")
        raise typer.Exit(EXIT_INTERRUPTED)
    if document.status is RunStatus.STOPPED:
        fail(f"stopped: {document.reason}")
        fail(f"continue with: {continuing}")
        raise typer.Exit(EXIT_STOPPED)
