"""`robogauntlet run`: run a suite."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

import typer

from robogauntlet.adapters.catalog import simulators
from robogauntlet.orchestrator.cli.common import (
    HistoryUrl,
    ImageSizeSetting,
    Latency,
    Policies,
    PolicyOptions,
    RenderProfileSetting,
    ReplanEvery,
    SeedCount,
    Success,
    Tasks,
    WorkersSetting,
    out,
    print_line,
    suite_settings,
)
from robogauntlet.orchestrator.cli.playing import play_plan
from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.orchestrator.runs.composition import compose_plan, new_run_folder
from robogauntlet.orchestrator.runs.plan import Plan, make_plan
from robogauntlet.orchestrator.trackers import PROJECT, open_tracker
from robogauntlet.policies.references import option_text, read_options, read_reference, with_options
from robogauntlet.results.run_document import RUN_FILE, RunArguments, read_run
from robogauntlet.results.run_owner import is_own
from robogauntlet.results.store.database import without_password
from robogauntlet.suites.selection import SuiteSelection
from robogauntlet.suites.timing import Timing, is_measured
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
    latency: Latency = None,
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
    tracker: Annotated[
        str | None,
        typer.Option(
            metavar="[wandb|mlflow]",
            help="Send progress, results and videos to an experiment tracker while the run plays.",
        ),
    ] = None,
    project: Annotated[str, typer.Option(help="With --tracker: project of W&B, experiment of MLflow.")] = PROJECT,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print a line for each episode.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but problems.")] = False,
) -> None:
    """Run a suite, or continue a run, and write its report.

    In a folder with a run of the suite, only the missing episodes are played. Without a suite, one is composed of
    --policy, --task, --seeds (20 by default) and --condition, and written into the run folder.
    """
    out.quiet = quiet or out.quiet
    required = tuple(require or ())
    tracking = None if tracker is None else open_tracker(tracker, project, print_line)
    policy_options, modelled = read_options(option or ()), None if is_measured(latency) else latency
    settings = suite_settings(success, image_size, replan_every, render_profile, workers, modelled)
    if suite is not None and _is_task(suite):
        task, suite = [suite, *(task or ())], None
    if suite is None:
        missing = [name for name, given in (("--policy", policy), ("--task", task)) if not given]
        if missing:
            raise BadInput(f"expected a suite, or --policy and --task; got no {' and no '.join(missing)}")
    elif condition:
        raise BadInput(
            "--condition: expected --policy and --task instead of a suite file, which lists its own conditions"
        )
    else:
        _refuse_run_folder(suite)

    def planned(settings: Mapping[str, Any]) -> tuple[Plan, Path, SuiteSelection]:
        if suite is None:
            plan, folder = compose_plan(
                with_options([read_reference(text) for text in policy or ()], policy_options),
                task or (),
                seeds=seeds,
                conditions=condition or (),
                folder=out_folder,
                only=required,
                settings=settings,
            )
            return plan, folder, SuiteSelection()
        part = SuiteSelection(tuple(policy or ()), tuple(task or ()), seeds, policy_options, settings)
        plan = make_plan(find_suite(suite), part=part, only=required)
        return plan, out_folder or new_run_folder(plan.suite.name), part

    plan, folder, part = planned(settings)
    if is_measured(latency):
        plan, folder, part = planned(settings | _measured(latency or "", plan, folder))
    arguments = RunArguments(
        policies=part.policies,
        options=tuple(option_text(name, value) for name, value in part.options.items()),
        tasks=part.tasks,
        seeds=part.seeds,
        **part.settings,
        require=required,
        address=address,
        history=None if history is None else without_password(history),
        retry_errors=retry_errors,
        media=media,
        tracker=tracker,
        project=None if tracker is None else project,
    )
    play_plan(plan, folder, arguments, store=store, history=history, tracker=tracking, verbose=verbose)


def _measured(latency: str, plan: Plan, folder: Path) -> dict[str, Timing]:
    """Measure the answers of the plan's policy, say so, and return what a suite states then."""
    from robogauntlet.orchestrator.kit.policy.check import Probe
    from robogauntlet.orchestrator.kit.policy.measured_latency import measured_timing

    if (folder / RUN_FILE).exists():
        raise BadInput(
            f"--latency: {folder} has a run, with the latency that was measured; "
            f"continue it: robogauntlet resume {shlex.quote(str(folder))}"
        )
    names = [name for name in plan.sources if name not in plan.suite.reference_policies]
    if len(names) != 1:
        got = counted(len(names), "policy", "policies")
        raise BadInput(f"--latency: expected one policy, whose answers are measured; got {got}")
    probe = Probe(names[0], plan.sources[names[0]], plan.cells[0].task, image_size=plan.suite.image_size)
    with out.status(f"measuring the answers of {probe.name}"):
        timing, line = measured_timing(latency, probe)
    print_line(line)
    return {} if timing is None else {"timing": timing}


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
