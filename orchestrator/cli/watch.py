"""`robogauntlet watch`: evaluate the checkpoints of a training while it trains."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import EXIT_INTERRUPTED, HistoryUrl, PolicyOptions, fail, out, print_line
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.orchestrator.runs.checkpoint_folder import ReadyCheckpoints
from robogauntlet.orchestrator.runs.checkpoint_watch import SETTLE_S, CheckpointWatch, Watched
from robogauntlet.orchestrator.runs.composition import RUNS
from robogauntlet.policies.references import option_text, read_options
from robogauntlet.results.analysis.learning_curve import LearningCurve
from robogauntlet.results.report.comparison import in_one_line
from robogauntlet.results.report.learning_curve import best_sentence, render_learning_curve, table
from robogauntlet.support.errors import BadInput, describe_os_error
from robogauntlet.support.files import exclusive, write_whole

PAGE, LOCK = "learning-curve.html", ".watch.lock"


def watch(
    folder: Annotated[Path, typer.Argument(help="Folder into which a training writes its checkpoints.")],
    suite: Annotated[str, typer.Option(help="Suite file or name of a shipped suite that each checkpoint plays.")],
    policy_kind: Annotated[
        str | None,
        typer.Option(
            metavar="KIND",
            help="Kind of the checkpoints: lerobot, another one with an option checkpoint, or python:MODULE:NAME, "
            "which gets the folder as its argument checkpoint; by default as the checkpoint tells.",
            show_default=False,
        ),
    ] = None,
    option: PolicyOptions = None,
    out_folder: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder for a run of each checkpoint, which the same command continues; by default "
            "runs/SUITE-TRAINING.",
            show_default=False,
        ),
    ] = None,
    until: Annotated[
        int | None, typer.Option(min=1, help="End when this number of checkpoints is evaluated.", show_default=False)
    ] = None,
    idle: Annotated[
        float | None,
        typer.Option(min=0, help="End when nothing was written or played for so long (s).", show_default=False),
    ] = None,
    settle: Annotated[
        float, typer.Option(min=0, help="Time without a change after which a checkpoint counts as written (s).")
    ] = SETTLE_S,
    history: HistoryUrl = None,
) -> None:
    """Evaluate each checkpoint of a training when it is written.

    The newest comes first. After each, the learning curve is printed and written as a page, with the comparison to the
    checkpoint before it. The best checkpoint is chosen on even seeds and measured on odd ones.

    Exit codes: 0 ended by --until or --idle, 2 bad input, 130 interrupted; the same command continues.
    """
    options = read_options(option or ())
    watched = Watched.read(folder, suite, policy_kind, options)
    target = out_folder or RUNS / f"{watched.suite.name}-{watched.policy}"
    arguments = ["robogauntlet", "watch", str(folder), "--suite", suite]
    arguments += [] if policy_kind is None else ["--policy-kind", policy_kind]
    arguments += [argument for name, value in options.items() for argument in ("--option", option_text(name, value))]
    ends = {"--until": until, "--idle": idle, "--settle": None if settle == SETTLE_S else settle}
    arguments += [str(part) for given in ends.items() if given[1] is not None for part in given]
    command = shlex.join([*arguments, "--out", str(target)])
    watching = CheckpointWatch(watched, target, ReadyCheckpoints(folder, settle, fail), fail, out, command, history)
    try:
        target.mkdir(parents=True, exist_ok=True)
        with exclusive(target / LOCK, BadInput(f"{target}: another process watches a training into this folder")):
            watching.continue_runs()
            print_line(f"{folder}: checkpoints are played in suite '{watched.suite.name}' into {target}")
            if watching.curve.points:
                _show(watching.curve, watched.suite.name, target / PAGE)
            for one in watching.evaluations(until, idle):
                _show(watching.curve, watched.suite.name, target / PAGE)
                for comparison in watching.comparisons(one):
                    print_line(in_one_line(comparison))
    except OSError as error:
        raise BadInput(f"{target}: {describe_os_error(error)}") from None
    except KeyboardInterrupt:
        fail(f"interrupted; continue with: {command}")
        raise typer.Exit(EXIT_INTERRUPTED) from None


def _show(curve: LearningCurve, suite: str, page: Path) -> None:
    out.print()
    out.print(rich_table(table(curve), title=f"{curve.policy}: clean episodes of {suite}"))
    print_line(best_sentence(curve))
    write_whole(page, render_learning_curve(curve, suite))
    print_line(f"page: {page}")
