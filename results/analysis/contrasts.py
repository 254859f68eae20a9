"""The one engine of comparisons: two sides on the same episodes, stratum by stratum, and their tests adjusted together.

A comparison differs from another in its question only: into which strata the pairs are divided, which test is made,
how the p-values are adjusted, and by which margin a side may be worse.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

from robogauntlet.results.record import Status
from robogauntlet.results.statistics.multiplicity import holm
from robogauntlet.results.statistics.pairs import (
    Pairs,
    can_reject,
    detectable_drop,
    is_no_worse,
    mcnemar,
    paired_difference,
)
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.suites.episode import Condition

if TYPE_CHECKING:
    import pandas as pd


OUTCOMES = ("simulator", "task", "status", "status_before")
"""Columns of a table of pairs; `status_before` is the outcome of the second side. Both are verdicts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contrast:
    """Two sides on the pairs of a stratum; of `simulator` to `severity`, those that its pairs differ in are None."""

    simulator: str | None = None
    task: str | None = None
    axis: str | None = None
    severity: int | None = None
    tasks: int
    """Number of tasks that have pairs."""
    pairs: Pairs
    difference: Estimate
    """Success rate of the first side minus that of the second, between -1 and 1."""
    p: float
    detectable: float | None
    """The smallest difference that this many pairs show with a probability of 0.8, see `pairs.detectable_drop`."""
    adjusted: float = 1.0
    """The p-value adjusted for all tests of the question; 1 if the test is not among them."""
    opposite: float | None = None
    """The adjusted p-value of the test in the other direction, of a question in one direction."""
    no_worse: bool | None = None
    """Whether the first side is shown to be worse by less than the margin; None without a margin."""

    @property
    def condition(self) -> Condition | None:
        """The axis and severity."""
        return None if self.axis is None or self.severity is None else Condition(self.axis, self.severity)


Strata = Iterable[tuple[dict[str, Any], "pd.DataFrame"]]
"""Pairs by what those of a stratum have in common: names and values of `simulator` to `severity` of `Contrast`."""
Test = Callable[[Pairs], float]
Adjustment = Callable[[Sequence[float]], Sequence[float]]


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked of two sides."""

    strata: tuple[Callable[[pd.DataFrame], Strata], ...]
    """Each divides the pairs of a comparison."""
    level: float
    """Of a test in one direction: half that of a test in both. The confidence of intervals is 1 - 2 `level`."""
    test: Test = mcnemar
    opposite: Test | None = None
    """The test in the other direction, if `test` is one in one direction."""
    adjust: Adjustment = holm
    margin: float | None = None
    """Largest decrease of a rate that counts as no worse; None to ask nothing of the kind."""
    tests_all: bool = False
    """Whether contrasts that cannot reach `level` are tested, too, see `pairs.can_reject`."""

    def adjusted(self, compared: Sequence[Sequence[Pairs]], test: Test) -> list[list[float]]:
        """The p-values of a test of the contrasts of several comparisons, adjusted together."""
        tested = [[test(p) if self.tests_all or can_reject(p, self.level) else None for p in own] for own in compared]
        return together(tested, self.adjust)


def contrasts(compared: Sequence[pd.DataFrame], question: Question) -> list[tuple[Contrast, ...]]:
    """Ask a question of several comparisons, whose tests are adjusted together.

    Args:
        compared: Per comparison, a row per pair with the columns `OUTCOMES` and those that the strata need.
        question: The question.

    Returns:
        Per comparison, its contrasts in the order of the strata.

    Raises:
        ValueError: A level or margin that is none.
    """
    question = replace(question, test=cache(question.test))
    found = [
        [_contrast(own, stratum, question) for grouper in question.strata for stratum, own in grouper(pairs)]
        for pairs in compared
    ]
    families = [[row.pairs for row in own] for own in found]
    p_values = question.adjusted(families, question.test)
    others: Sequence[Sequence[float | None]] = [[None] * len(own) for own in found]
    if question.opposite is not None:
        others = question.adjusted(families, question.opposite)
    return [
        tuple(replace(row, adjusted=p, opposite=other) for row, p, other in zip(*own, strict=True))
        for own in zip(found, p_values, others, strict=True)
    ]


def _contrast(own: pd.DataFrame, stratum: dict[str, Any], question: Question) -> Contrast:
    won = (own[column] == str(Status.SUCCESS) for column in ("status", "status_before"))
    pairs = Pairs.from_outcomes(*(side.to_numpy(float) for side in won))
    confidence = 1 - 2 * question.level
    difference = paired_difference(pairs, confidence)
    assert difference is not None  # A stratum has a pair.
    return Contrast(
        **stratum,
        tasks=own["task"].nunique(),
        pairs=pairs,
        difference=difference,
        p=question.test(pairs),
        detectable=detectable_drop(pairs, question.level),
        no_worse=None if question.margin is None else is_no_worse(pairs, question.margin, confidence),
    )


def together(p_values: Sequence[Sequence[float | None]], adjust: Adjustment = holm) -> list[list[float]]:
    """Adjust the p-values of several comparisons together; None is no test and gets 1."""
    adjusted = iter(adjust([p for own in p_values for p in own if p is not None]))
    return [[1.0 if p is None else next(adjusted) for p in own] for own in p_values]


def all_pairs(pairs: pd.DataFrame) -> Strata:
    """All pairs together."""
    yield {}, pairs


def all_tasks(pairs: pd.DataFrame) -> Strata:
    """All pairs together, if they are of several tasks."""
    if pairs["task"].nunique() > 1:
        yield {}, pairs


def by_simulator(pairs: pd.DataFrame) -> Strata:
    """The simulators with several tasks, if there are several simulators."""
    groups = list(pairs.groupby("simulator", sort=False, observed=True))
    for simulator, own in groups if len(groups) > 1 else ():
        if own["task"].nunique() > 1:
            yield {"simulator": str(simulator)}, own


def by_task(pairs: pd.DataFrame) -> Strata:
    """The tasks, in the order of the pairs."""
    for task, own in pairs.groupby("task", sort=False, observed=True):
        yield {"simulator": str(task).partition("/")[0], "task": str(task)}, own


def by_condition(pairs: pd.DataFrame) -> Strata:
    """The conditions, by axis and severity."""
    for (axis, severity), own in pairs.groupby(["axis", "severity"], sort=True, observed=True):
        yield {"axis": str(axis), "severity": int(severity)}, own
