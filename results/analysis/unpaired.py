"""Two policies whose start states are not known, compared on separate trials of the tasks that both played."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.comparison import Side
from robogauntlet.results.record import Status
from robogauntlet.results.statistics.multiplicity import holm
from robogauntlet.results.statistics.rates import Estimate, rate_difference
from robogauntlet.results.statistics.separate_trials import Separate, fisher

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, kw_only=True)
class UnpairedContrast:
    """Two sides on their trials of a task, or of all tasks of both."""

    task: str | None = None
    """None for all tasks."""
    counts: Separate
    difference: Estimate
    """Success rate of the first side minus that of the second, all trials alike."""
    p: float
    """Of the exact test, for all tasks stratified by them."""
    adjusted: float = 1.0
    """Adjusted by Holm's method over all comparisons, or over all their tasks."""


@dataclass(frozen=True, slots=True)
class UnpairedComparison:
    """A policy against another on separate trials."""

    first: Side
    second: Side
    overall: UnpairedContrast
    tasks: tuple[UnpairedContrast, ...]
    errors: tuple[int, int]
    """Trials of each that ended in an error; they are left out."""
    alone: tuple[int, int]
    """Trials of each with a verdict, in tasks that the other has none of; they are left out."""
    is_balanced: bool
    """Whether both have the same share of their trials in each task; if not, the difference overall mixes tasks."""


def states_known(rows: pd.DataFrame) -> bool:
    """Whether the start states of all episodes with a verdict are known."""
    return bool((rows["state_hash"][rows["status"] != str(Status.ERROR)] != "").all())


def by_task(first: pd.DataFrame, second: pd.DataFrame) -> dict[str, Separate]:
    """Counts of the tasks in which both sides have a verdict, in the order of the first side's rows."""
    one, other = (_counts(rows) for rows in (first, second))
    return {task: Separate(*one[task], *other[task]) for task in one if task in other}


def _counts(rows: pd.DataFrame) -> Mapping[str, tuple[int, int]]:
    """Task to its successes and verdicts."""
    verdicts = rows[rows["status"] != str(Status.ERROR)]
    won = (verdicts["status"] == str(Status.SUCCESS)).groupby(verdicts["task"].astype(str), sort=False)
    return {str(task): (int(own.sum()), len(own)) for task, own in won}


def compare_unpaired(
    first: tuple[Side, pd.DataFrame], second: tuple[Side, pd.DataFrame], alpha: float
) -> UnpairedComparison | None:
    """Compare two policies by their clean episodes; None if no task has a verdict of both.

    Args:
        first: A policy, and its clean rows with the columns `task`, `status` and `state_hash`.
        second: The other one.
        alpha: 1 - alpha is the confidence of intervals.
    """
    counts = by_task(first[1], second[1])
    if not counts:
        return None
    whole = Separate(
        *(
            sum(getattr(one, name) for one in counts.values())
            for name in ("first", "first_trials", "second", "second_trials")
        )
    )
    tasks = tuple(_contrast([one], one, alpha, task) for task, one in counts.items())
    errors = [int((rows["status"] == str(Status.ERROR)).sum()) for _, rows in (first, second)]
    alone = (len(first[1]) - errors[0] - whole.first_trials, len(second[1]) - errors[1] - whole.second_trials)
    size, other = whole.first_trials, whole.second_trials
    shares = (one.first_trials * other == one.second_trials * size for one in counts.values())
    overall = _contrast(list(counts.values()), whole, alpha)
    return UnpairedComparison(first[0], second[0], overall, tasks, (errors[0], errors[1]), alone, all(shares))


def _contrast(strata: Sequence[Separate], counts: Separate, alpha: float, task: str | None = None) -> UnpairedContrast:
    sides = (counts.first, counts.first_trials), (counts.second, counts.second_trials)
    difference = rate_difference(*sides, confidence=1 - alpha)
    assert difference is not None  # Both have a trial.
    p = fisher(strata)
    return UnpairedContrast(task=task, counts=counts, difference=difference, p=p, adjusted=p)


def adjusted(found: Sequence[UnpairedComparison]) -> tuple[UnpairedComparison, ...]:
    """The comparisons with p-values adjusted over all of them, and over all their tasks."""
    overall = iter(holm([one.overall.p for one in found]))
    tasks = iter(holm([line.p for one in found for line in one.tasks]))
    return tuple(
        replace(
            one,
            overall=replace(one.overall, adjusted=next(overall)),
            tasks=tuple(replace(line, adjusted=next(tasks)) for line in one.tasks),
        )
        for one in found
    )
