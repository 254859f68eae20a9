"""`robogauntlet search checkpoint`: find the checkpoint that became worse."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from robogauntlet.orchestrator.api.bisection import MAX_SEEDS, plan_search, play_search
from robogauntlet.orchestrator.api.evaluation import EvaluationStopped
from robogauntlet.orchestrator.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_STOPPED,
    AsJson,
    HistoryUrl,
    PolicyOptions,
    Success,
    fail,
    out,
    print_json,
    print_line,
)
from robogauntlet.orchestrator.runs.checkpoint_search import CheckpointSearchResult
from robogauntlet.orchestrator.runs.progress_display import ProgressDisplay
from robogauntlet.policies.references import FORMS, option_text, read_options
from robogauntlet.support.text import counted


def search(
    good: Annotated[str, typer.Option("--good", help=f"The policy before the checkpoints: {FORMS}.")],
    bad: Annotated[str, typer.Option("--bad", help="The policy after them, which is worse.")],
    task: Annotated[
        list[str],
        typer.Option("--task", help="Play this task (simulator/task), or tasks that match a pattern. Repeatable."),
    ],
    checkpoints: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="CHECKPOINTS",
            help="The policies between them, in their order. Without any, only the ends are compared.",
            show_default=False,
        ),
    ] = None,
    option: PolicyOptions = None,
    success: Success = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            "--seeds",
            min=1,
            max=MAX_SEEDS,
            help="The most seeds per checkpoint and task; by default 200, or as many as the tasks have stored states.",
            show_default=False,
        ),
    ] = None,
    out_folder: Annotated[
        Path | None, typer.Option("--out", help="Run folder; the same search that is in it is continued.")
    ] = None,
    retry_errors: Annotated[
        bool, typer.Option("--retry-errors", help="Play the episodes again that ended in an error.")
    ] = False,
    history: HistoryUrl = None,
    as_json: AsJson = False,
) -> None:
    """Find the first checkpoint that became worse.

    Worse is a checkpoint that loses at least half of the difference between --good and --bad. Plays as few episodes as
    a sequential test allows. The answer, a checkpoint or a range of them, is right with a probability of at least 95 %,
    whatever the number of checkpoints.

    Exit codes: 0 found, 2 bad input or the ends do not differ, 3 stopped early or the seeds did not decide (a range is
    printed), 130 interrupted; the same command with --out continues.
    """
    settings = {} if success is None else {"success": str(success)}
    texts, options = [good, *(checkpoints or ()), bad], read_options(option or ())
    plan, folder = plan_search(texts, task, seeds, out_folder, options, settings)
    arguments = ["robogauntlet", "search", "checkpoint", "--good", good, "--bad", bad, *(checkpoints or ())]
    arguments += [argument for name in task for argument in ("--task", name)]
    arguments += [argument for name, value in options.items() for argument in ("--option", option_text(name, value))]
    arguments += [] if success is None else ["--success", str(success)]
    command = shlex.join([*arguments, "--seeds", str(plan.suite.seeds.count), "--out", str(folder)])
    if not as_json:
        print_line(f"{plan.suite.name}: {counted(plan.episodes, 'episode')} at most, into {folder}")
    display = ProgressDisplay(Console(quiet=True) if as_json else out)
    try:
        found = play_search(
            texts, plan, folder, display, fail, retry_errors=retry_errors, history=history, command=command
        )
    except KeyboardInterrupt:
        fail(f"interrupted; continue with: {command}")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    except EvaluationStopped as stopped:
        fail(f"stopped: {stopped}")
        fail(f"continue with: {command}")
        raise typer.Exit(EXIT_STOPPED) from None
    if as_json:
        print_json(found)
    else:
        _print(found, folder)
    if found.first_worse is None:
        raise typer.Exit(EXIT_STOPPED)


def _print(found: CheckpointSearchResult, folder: Path) -> None:
    table = Table("checkpoint", "success", "errors", "worse", box=None, pad_edge=False)
    answers = {True: "yes", False: "no", None: ""}
    for one in found.checkpoints:
        played = one.successes + one.failures
        success = f"{one.successes:,} of {played:,}" if played else "not played"
        table.add_row(one.checkpoint, success, f"{one.errors:,}" if one.errors else "", answers[one.is_worse])
    out.print(table)
    sure = f"with {100 * found.confidence:.0f} % confidence"
    if found.first_worse is not None:
        print_line(f"first worse: {found.first_worse}, after {found.last_good}, {sure}")
    else:
        print_line(f"first worse: one of {', '.join(found.candidates)}, {sure}; the seeds do not decide which")
    print_line(
        f"{counted(found.episodes, 'episode')}; all checkpoints on all seeds would have been {found.all_episodes:,}"
    )
    print_line(f"report: {folder / 'report.html'}")
