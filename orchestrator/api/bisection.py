"""`robogauntlet.bisect`: find the checkpoint that became worse."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from robogauntlet.orchestrator.api.evaluation import EvaluationStopped
from robogauntlet.orchestrator.runs.checkpoint_search import CheckpointSearch, CheckpointSearchResult
from robogauntlet.orchestrator.runs.composition import compose_plan
from robogauntlet.orchestrator.runs.history_observer import HistoryObserver
from robogauntlet.orchestrator.runs.plan import Plan
from robogauntlet.orchestrator.runs.progress_display import ProgressDisplay
from robogauntlet.orchestrator.runs.run import RunOptions, run_plan
from robogauntlet.orchestrator.runs.suite_names import PlanError
from robogauntlet.policies.references import read_reference, with_options
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.store.run_history import history_url
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import counted

SEEDS = 200
"""Largest number of seeds per checkpoint and task, if none is given and the tasks do not have fewer stored states."""
MAX_SEEDS = 10_000
PREFIX = "bisect-"
"""What the name of the suite begins with, so that its runs are no baselines of others."""


def bisect(
    good: str | Path,
    bad: str | Path,
    checkpoints: Sequence[str | Path],
    tasks: str | Sequence[str],
    seeds: int | None = None,
    out: Path | str | None = None,
    *,
    options: Mapping[str, Any] | None = None,
    quiet: bool = False,
    **settings: Any,
) -> CheckpointSearchResult:
    """Find the first checkpoint that is worse than `good` by at least half of the difference of the ends.

    Plays clean episodes in rounds, as few as the sequential test of
    [`bisect_checkpoints`][robogauntlet.results.statistics.bisection.bisect_checkpoints] allows.

    Args:
        good: The policy before the checkpoints, as a text that the command line takes.
        bad: The policy after them.
        checkpoints: Those between, in their order. Without any, only the ends are compared.
        tasks: A task, `simulator/task`, or a pattern such as `pybullet/*`; or several.
        seeds: Largest number of seeds per checkpoint and task, from 0; by default 200, or as many as the tasks have
            stored states.
        out: Run folder; by default a new one below `runs/`. A search of the same checkpoints, tasks and seeds that is
            in it is continued.
        options: Options of the policies; each goes to those whose kind has it.
        quiet: Print no progress.
        **settings: Further keys of a suite, such as `image_size=224` or `workers=2`.

    Raises:
        BadInput: Something does not exist, or is not as described, and nothing is started; or, after playing, the ends
            do not differ.
        PolicyError: A policy cannot be used. Nothing is started.
        PlanError: The run cannot be started, or `out` holds another run.
        EvaluationStopped: The run ended early.
    """
    texts, listed = [str(text) for text in (good, *checkpoints, bad)], [tasks] if isinstance(tasks, str) else tasks
    plan, folder = plan_search(texts, listed, seeds, None if out is None else Path(out), options or {}, settings)
    return play_search(texts, plan, folder, ProgressDisplay(Console(quiet=quiet)), warnings.warn)


def plan_search(
    texts: Sequence[str],
    tasks: Sequence[str],
    seeds: int | None,
    folder: Path | None,
    options: Mapping[str, Any],
    settings: Mapping[str, Any],
) -> tuple[Plan, Path]:
    """Plan the episodes of all checkpoints, the good one first and the bad one last, and return the folder too.

    Raises:
        BadInput: Something does not exist, or is not as described, or a policy is there twice.
        PolicyError: A policy cannot be used.
        PlanError: The run cannot be started.
    """
    if isinstance(seeds, bool) or not isinstance(seeds, int | None) or (seeds or 0) > MAX_SEEDS:
        raise BadInput(f"seeds: expected their number, {MAX_SEEDS:,} at most, got {seeds!r}")
    for number, text in enumerate(texts):
        if text in texts[:number]:
            raise BadInput(f"expected each policy once, got '{text}' twice")
    entries = with_options([read_reference(text) for text in texts], options)
    plan, folder = compose_plan(
        entries, tasks, seeds=seeds, most=SEEDS, folder=folder, settings=settings, prefix=PREFIX
    )
    if plan.unavailable:
        raise PlanError("\n".join(f"{name}: {reason}" for name, reason in plan.unavailable.items()))
    return plan, folder


def play_search(
    texts: Sequence[str],
    plan: Plan,
    folder: Path,
    display: ProgressDisplay,
    on_warning: Callable[[str], None],
    *,
    retry_errors: bool = False,
    history: str | None = None,
    command: str | None = None,
) -> CheckpointSearchResult:
    """Play the rounds of a planned search into a folder; for the rest see `bisect` and `RunOptions`."""
    search = CheckpointSearch(dict(zip(texts, plan.sources, strict=True)), plan.suite.seeds.count, display.log)
    url = history_url(history or os.environ.get("ROBOGAUNTLET_HISTORY") or None, folder.absolute().parent)
    options = RunOptions(media=False, retry_errors=retry_errors, command=command)
    outcome = run_plan(plan, folder, options, [display, HistoryObserver(url, folder)], rounds=search)
    for warning in outcome.warnings:
        on_warning(warning)
    if outcome.document.status is RunStatus.INTERRUPTED:
        raise KeyboardInterrupt
    if outcome.document.status is RunStatus.STOPPED:
        raise EvaluationStopped(f"{folder}: {outcome.document.reason}")
    if search.alike is not None:
        raise BadInput(f"{search.alike}; give other ends, or more seeds")
    if search.result is None:
        raise EvaluationStopped(f"{folder}: {_why(search, outcome.document.skipped)}")
    return search.result


def _why(search: CheckpointSearch, skipped: Mapping[str, str]) -> str:
    """Why a search has no result though all of its episodes were played."""
    for one in search.counts:
        if one.checkpoint == search.unplayable:
            return f"{one.checkpoint}: {counted(one.errors, 'episode')} ended in an error, none was played"
    return "; ".join(f"{name} is skipped: {reason}" for name, reason in skipped.items())
