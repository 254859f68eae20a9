"""All axes of a policy in a few numbers, and whether simulators agree on which axes hurt it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from results.judging import Judged
from results.run import PlannedCell, RunDocument
from results.statistics.aggregate import (
    Outcomes,
    interquartile_mean,
    mean_outcomes,
    percentile_estimates,
    resampled_means,
    tail_mean,
)
from results.statistics.agreement import kendall_p, kendall_tau, rank_violation
from results.statistics.rates import CONFIDENCE, Estimate, Interval
from suites.vocabulary import CLEAN, CONTROLS, Condition, content_hash

DRAWS, AGREEMENT_DRAWS = 1000, 200
ENDS = ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2)
LEAST_AXES = 3
"""Fewer have no order worth comparing."""

Means = NDArray[np.float64]
Losses = Mapping[str, NDArray[np.float64]]
"""Axis to the clean rate minus the rate at its levels, on average: as was seen, then in data sets drawn."""


@dataclass(frozen=True, slots=True)
class WorstAxis:
    """The axis under which a policy does worst, its severities weighing alike."""

    axis: str
    rate: Estimate
    certainty: float
    """Share of the bootstrap's data sets in which it is the worst, too; one in which n axes are counts as 1 / n."""


@dataclass(frozen=True, slots=True)
class OverallRow:
    """One policy over all levels of all axes, in one simulator or in all."""

    policy: str
    simulator: str | None
    """None for all simulators together; tasks weigh the same."""
    conditions: int
    """Levels of axes that count, the clean condition not among them."""
    mean: Estimate
    middle: Estimate
    """Interquartile mean over the levels."""
    tail: Estimate
    """Mean of the worst fifth of the levels (CVaR)."""
    worst: WorstAxis


@dataclass(frozen=True, slots=True)
class AgreementRow:
    """Whether two simulators order the axes alike by what one policy loses along them."""

    policy: str
    one: str
    other: str
    axes: int
    """That both have."""
    tau: Estimate | None
    """Kendall's tau-b, its interval that of other seeds for the same axes; None where a side ties all axes."""
    p: float | None
    """One-sided, against orders that have nothing to do with each other; axes count as a sample of many."""
    violation: float
    """MMRV: what the worst disagreement in order costs an axis, on average, as a rate in the first simulator."""


@dataclass(frozen=True, slots=True)
class Overall:
    """What a report says about all axes together."""

    rows: tuple[OverallRow, ...]
    agreement: tuple[AgreementRow, ...]


def build_overall(document: RunDocument, judged: Judged) -> Overall | None:
    """All axes together, for every policy but the gate and the floors; None if nothing was perturbed along an axis.

    Args:
        document: The run.
        judged: What counts of its rows.
    """
    aside = (document.gate, *document.floors)
    rows: list[OverallRow] = []
    agreement: list[AgreementRow] = []
    for policy in dict.fromkeys(cell.policy for cell in document.plan if cell.policy not in aside):
        cells = [cell for cell in document.plan if cell.policy == policy and cell.axis not in CONTROLS]
        seen = _Seen.of(policy, cells, judged)
        if seen.levels and seen.tasks:
            rows += _rows(policy, seen)
            agreement += _agreements(policy, seen)
    return Overall(tuple(rows), tuple(agreement)) if rows else None


@dataclass(frozen=True, eq=False)
class _Seen:
    """What one policy did."""

    levels: tuple[Condition, ...]
    """Of axes, in the order of the plan."""
    tasks: tuple[str, ...]
    strata: tuple[Outcomes, ...]
    """Of each task, shape (seeds, 1 + levels): the clean condition first, NaN where nothing counts."""
    generator: np.random.Generator

    @classmethod
    def of(cls, policy: str, cells: Sequence[PlannedCell], judged: Judged) -> _Seen:
        levels = tuple(dict.fromkeys(Condition(cell.axis, cell.severity) for cell in cells if cell.axis != CLEAN))
        found = judged.by_condition(cells, (Condition(), *levels))
        generator = np.random.default_rng(int(content_hash(["overall", policy]), 16))
        return cls(levels, tuple(found), tuple(found.values()), generator)

    def places(self, simulator: str | None) -> list[int]:
        """Which of the tasks are a simulator's; None for all."""
        return [i for i, task in enumerate(self.tasks) if simulator in (None, task.partition("/")[0])]

    @property
    def simulators(self) -> tuple[str, ...]:
        """Those of the tasks."""
        return tuple(dict.fromkeys(task.partition("/")[0] for task in self.tasks))


def _rows(policy: str, seen: _Seen) -> list[OverallRow]:
    outcomes = [stratum[:, 1:] for stratum in seen.strata]
    means = mean_outcomes(outcomes)[None]
    drawn = resampled_means(outcomes, seen.generator, DRAWS)
    rows = []
    for simulator in (None, *seen.simulators) if len(seen.simulators) > 1 else seen.simulators:
        tasks = seen.places(simulator)
        counting = [i for i in range(len(seen.levels)) if not np.isnan(means[0, tasks, i]).all()]
        if counting:
            levels = [seen.levels[i] for i in counting]
            sides = (_over_tasks(found[:, tasks][..., counting]) for found in (means, drawn))
            rows.append(_row(policy, simulator, levels, *sides))
    return rows


def _row(policy: str, simulator: str | None, levels: Sequence[Condition], means: Means, drawn: Means) -> OverallRow:
    """Args: means, drawn: mean outcomes of each level, shape (1, levels) and (draws, levels)."""
    axes = _by_axis(levels)

    def numbers(by_level: Means) -> Means:
        of_all = [by_level.mean(axis=-1), interquartile_mean(by_level), tail_mean(by_level)]
        return np.stack([*of_all, *(by_level[:, own].mean(axis=-1) for own in axes.values())], axis=-1)

    of_drawn = numbers(drawn)
    mean, middle, tail, *rates = percentile_estimates(numbers(means)[0], of_drawn)
    worst = int(np.argmin([estimate.value for estimate in rates]))
    lowest = of_drawn[:, 3:] == of_drawn[:, 3:].min(axis=-1, keepdims=True)
    certainty = float((lowest[:, worst] / lowest.sum(axis=-1)).mean())
    return OverallRow(
        policy, simulator, len(levels), mean, middle, tail, WorstAxis(list(axes)[worst], rates[worst], certainty)
    )


def _agreements(policy: str, seen: _Seen) -> list[AgreementRow]:
    losses = {simulator: _losses(seen, simulator) for simulator in seen.simulators}
    rows = (_agreement(policy, one, other, losses[one], losses[other]) for one, other in combinations(losses, 2))
    return [row for row in rows if row is not None]


def _agreement(policy: str, one: str, other: str, ones: Losses, others: Losses) -> AgreementRow | None:
    axes = [axis for axis in ones if axis in others]
    if len(axes) < LEAST_AXES:
        return None
    # A pair of orders for each data set: the one that was seen, then those drawn.
    first, second = (np.array([losses[axis] for axis in axes]).T.tolist() for losses in (ones, others))
    violation = rank_violation(first[0], second[0])
    assert violation is not None  # there are axes
    tau, *drawn = map(kendall_tau, first, second)
    known = [value for value in drawn if value is not None]
    ends = Interval(*map(float, np.quantile(known, ENDS))) if len(known) == len(drawn) else None
    p = kendall_p(first[0], second[0])
    return AgreementRow(policy, one, other, len(axes), None if tau is None else Estimate(tau, ends), p, violation)


def _losses(seen: _Seen, simulator: str) -> Losses:
    """What is lost along each axis in one simulator; axes that no task has are left out."""
    lost = [seen.strata[place][:, :1] - seen.strata[place][:, 1:] for place in seen.places(simulator)]
    drawn = resampled_means(lost, seen.generator, AGREEMENT_DRAWS)
    means = np.concatenate([mean_outcomes(lost)[None], drawn])
    counting = [i for i in range(len(seen.levels)) if not np.isnan(means[0, :, i]).all()]
    by_level = _over_tasks(means[..., counting])
    axes = _by_axis([seen.levels[i] for i in counting])
    found = {axis: by_level[:, own].mean(axis=-1) for axis, own in axes.items()}
    return {axis: losses for axis, losses in found.items() if not np.isnan(losses).any()}


def _by_axis(levels: Sequence[Condition]) -> Mapping[str, list[int]]:
    """Axis to where its levels are."""
    axes = dict.fromkeys(level.axis for level in levels)
    return {axis: [i for i, level in enumerate(levels) if level.axis == axis] for axis in axes}


def _over_tasks(means: Means) -> Means:
    """Mean over the tasks in which a level counts, shape (draws, levels)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a level that no seed drawn has
        return np.asarray(np.nanmean(means, axis=-2))
