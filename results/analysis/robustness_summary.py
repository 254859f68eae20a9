"""Summary of a policy over all axes, and agreement of simulators on which axes reduce its success."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.analysis.eligible_episodes import EligibleEpisodes
from robogauntlet.results.run_document import PlannedCell, RunDocument
from robogauntlet.results.statistics.aggregate import (
    Outcomes,
    interquartile_mean,
    mean_outcomes,
    percentile_interval,
    resampled_means,
    tail_mean,
)
from robogauntlet.results.statistics.rank_agreement import kendall, rank_violation
from robogauntlet.results.statistics.rates import CONFIDENCE, Estimate, Interval
from robogauntlet.suites.episode import CLEAN, Condition, content_hash

DRAWS, AGREEMENT_DRAWS = 1000, 200
ENDS = ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2)
LEAST_AXES = 3
"""Simulators are compared only on this number of axes or more."""

Means = NDArray[np.float64]
Losses = Mapping[str, NDArray[np.float64]]
"""Axis to its mean loss (clean rate minus rate over its levels): of the data, then of the bootstrap samples."""


@dataclass(frozen=True, slots=True)
class WorstAxis:
    """The axis with the lowest mean success; severities have equal weight."""

    axis: str
    rate: Estimate
    certainty: float
    """Share of bootstrap samples in which it is the worst as well; a tie of n axes counts as 1 / n."""


@dataclass(frozen=True, slots=True)
class SummaryRow:
    """One policy over all levels of all axes, in one simulator or all."""

    policy: str
    simulator: str | None
    """None for all simulators; tasks have equal weight."""
    conditions: int
    """Number of perturbed levels that count."""
    mean: Estimate
    middle: Estimate
    """Interquartile mean over the levels."""
    tail: Estimate
    """Mean of the worst fifth of the levels (CVaR)."""
    worst: WorstAxis


@dataclass(frozen=True, slots=True)
class AgreementRow:
    """Agreement of two simulators on the order of axes by loss."""

    policy: str
    one: str
    other: str
    axes: int
    """Number of axes that both simulators have."""
    tau: Estimate | None
    """Kendall's tau-b; the interval covers other seeds, not other axes. None if a simulator ties all axes."""
    p: float | None
    """One-sided, against independent orders; axes are treated as a sample."""
    violation: float
    """MMRV: mean over axes of the largest rank violation, as a success rate in the first simulator."""


@dataclass(frozen=True, slots=True)
class RobustnessSummary:
    """All axes together."""

    rows: tuple[SummaryRow, ...]
    agreement: tuple[AgreementRow, ...]


def build_robustness_summary(document: RunDocument, eligible: EligibleEpisodes) -> RobustnessSummary | None:
    """Summarise all axes for every policy except oracle gate and no-skill baselines; None without perturbed levels."""
    excluded = document.suite.reference_policies
    rows: list[SummaryRow] = []
    agreement: list[AgreementRow] = []
    for policy in dict.fromkeys(cell.policy for cell in document.plan if cell.policy not in excluded):
        cells = [
            cell
            for cell in document.plan
            if cell.policy == policy and (cell.axis == CLEAN or cell.condition.is_on_scale)
        ]
        outcomes = _PolicyOutcomes.select(policy, cells, eligible)
        if outcomes.levels and outcomes.tasks:
            rows += _rows(policy, outcomes)
            losses = {simulator: _losses(outcomes, simulator) for simulator in outcomes.simulators}
            pairs = (
                _agreement(policy, one, other, losses[one], losses[other]) for one, other in combinations(losses, 2)
            )
            agreement += [row for row in pairs if row is not None]
    return RobustnessSummary(tuple(rows), tuple(agreement)) if rows else None


@dataclass(frozen=True, eq=False)
class _PolicyOutcomes:
    """Outcomes of one policy."""

    levels: tuple[Condition, ...]
    """Perturbed levels, in the order of the plan."""
    tasks: tuple[str, ...]
    strata: tuple[Outcomes, ...]
    """Per task, shape (seeds, 1 + levels): clean first, NaN where no episode counts."""
    generator: np.random.Generator

    @classmethod
    def select(cls, policy: str, cells: Sequence[PlannedCell], eligible: EligibleEpisodes) -> _PolicyOutcomes:
        levels = tuple(dict.fromkeys(cell.condition for cell in cells if cell.axis != CLEAN))
        found = eligible.by_condition(cells, (Condition(), *levels))
        generator = np.random.default_rng(int(content_hash(["overall", policy]), 16))
        return cls(levels, tuple(found), tuple(found.values()), generator)

    def places(self, simulator: str | None) -> list[int]:
        """Indices of a simulator's tasks; None for all."""
        return [i for i, task in enumerate(self.tasks) if simulator in (None, task.partition("/")[0])]

    @property
    def simulators(self) -> tuple[str, ...]:
        """Simulators of the tasks."""
        return tuple(dict.fromkeys(task.partition("/")[0] for task in self.tasks))


def _rows(policy: str, outcomes: _PolicyOutcomes) -> list[SummaryRow]:
    perturbed = [stratum[:, 1:] for stratum in outcomes.strata]
    means = mean_outcomes(perturbed)[None]
    drawn = resampled_means(perturbed, outcomes.generator, DRAWS)
    rows = []
    for simulator in (None, *outcomes.simulators) if len(outcomes.simulators) > 1 else outcomes.simulators:
        tasks = outcomes.places(simulator)
        counting = [i for i in range(len(outcomes.levels)) if not np.isnan(means[0, tasks, i]).all()]
        if counting:
            levels = [outcomes.levels[i] for i in counting]
            sides = (_over_tasks(found[:, tasks][..., counting]) for found in (means, drawn))
            rows.append(_row(policy, simulator, levels, *sides))
    return rows


def _row(policy: str, simulator: str | None, levels: Sequence[Condition], means: Means, drawn: Means) -> SummaryRow:
    """A row from mean outcomes per level, of the data (1, levels) and of bootstrap samples (draws, levels)."""
    axes = _by_axis(levels)

    def numbers(by_level: Means) -> Means:
        of_all = [by_level.mean(axis=-1), interquartile_mean(by_level), tail_mean(by_level)]
        return np.stack([*of_all, *(by_level[:, own].mean(axis=-1) for own in axes.values())], axis=-1)

    of_drawn = numbers(drawn)
    values = zip(numbers(means)[0], of_drawn.T, strict=True)
    mean, middle, tail, *rates = (Estimate(float(value), percentile_interval(column)) for value, column in values)
    worst = int(np.argmin([estimate.value for estimate in rates]))
    lowest = of_drawn[:, 3:] == of_drawn[:, 3:].min(axis=-1, keepdims=True)
    certainty = float((lowest[:, worst] / lowest.sum(axis=-1)).mean())
    return SummaryRow(
        policy, simulator, len(levels), mean, middle, tail, WorstAxis(list(axes)[worst], rates[worst], certainty)
    )


def _agreement(policy: str, one: str, other: str, ones: Losses, others: Losses) -> AgreementRow | None:
    axes = [axis for axis in ones if axis in others]
    if len(axes) < LEAST_AXES:
        return None
    # One pair of orders for the data, then one per bootstrap sample.
    first, second = (np.array([losses[axis] for axis in axes]).T.tolist() for losses in (ones, others))
    outcomes, *drawn = map(kendall, first, second)
    known = [agreement[0] for agreement in drawn if agreement is not None]
    ends = Interval(*map(float, np.quantile(known, ENDS))) if len(known) == len(drawn) else None
    tau, p = (None, None) if outcomes is None else (Estimate(outcomes[0], ends), outcomes[1])
    return AgreementRow(policy, one, other, len(axes), tau, p, rank_violation(first[0], second[0]))


def _losses(outcomes: _PolicyOutcomes, simulator: str) -> Losses:
    """Mean loss along each axis in one simulator; axes that no task supports are left out."""
    lost = [outcomes.strata[place][:, :1] - outcomes.strata[place][:, 1:] for place in outcomes.places(simulator)]
    drawn = resampled_means(lost, outcomes.generator, AGREEMENT_DRAWS)
    means = np.concatenate([mean_outcomes(lost)[None], drawn])
    counting = [i for i in range(len(outcomes.levels)) if not np.isnan(means[0, :, i]).all()]
    by_level = _over_tasks(means[..., counting])
    axes = _by_axis([outcomes.levels[i] for i in counting])
    found = {axis: by_level[:, own].mean(axis=-1) for axis, own in axes.items()}
    return {axis: losses for axis, losses in found.items() if not np.isnan(losses).any()}


def _by_axis(levels: Sequence[Condition]) -> Mapping[str, list[int]]:
    """Axis to the indices of its levels."""
    axes = dict.fromkeys(level.axis for level in levels)
    return {axis: [i for i, level in enumerate(levels) if level.axis == axis] for axis in axes}


def _over_tasks(means: Means) -> Means:
    """Mean over tasks in which a level counts, shape (draws, levels)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a level without any drawn seed
        return np.asarray(np.nanmean(means, axis=-2))
