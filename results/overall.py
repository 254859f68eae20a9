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
    DRAWS,
    Outcomes,
    bootstrap,
    interquartile_mean,
    mean_outcomes,
    resampled_means,
    tail_mean,
)
from results.statistics.agreement import kendall_p, kendall_tau, rank_violation
from results.statistics.rates import CONFIDENCE, Estimate, Interval
from suites.vocabulary import CLEAN, CONTROLS, Condition, content_hash

AGREEMENT_DRAWS = 400
ENDS = ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2)
LEAST_AXES = 3
"""Fewer have no order worth comparing."""

Means = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WorstAxis:
    """The axis under which a policy does worst, its severities weighing alike."""

    axis: str
    rate: Estimate
    certainty: float
    """Share of the bootstrap's data sets in which it is the worst, too."""


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
    policies = dict.fromkeys(cell.policy for cell in document.plan if cell.policy not in aside)
    rows, agreement = [], []
    for policy in policies:
        cells = [cell for cell in document.plan if cell.policy == policy and cell.axis not in CONTROLS]
        simulators = tuple(dict.fromkeys(cell.simulator for cell in cells))
        for simulator in (None, *simulators) if len(simulators) > 1 else simulators:
            row = _row(policy, simulator, [c for c in cells if simulator in (None, c.simulator)], judged)
            rows += [row] if row else []
        for one, other in combinations(simulators, 2):
            sides = [[cell for cell in cells if cell.simulator == name] for name in (one, other)]
            found = _agreement(policy, one, other, sides, judged)
            agreement += [found] if found else []
    return Overall(tuple(rows), tuple(agreement)) if rows else None


def _row(policy: str, simulator: str | None, cells: Sequence[PlannedCell], judged: Judged) -> OverallRow | None:
    levels, strata = _outcomes(cells, judged)
    if not levels:
        return None
    places = _places(levels)
    axes = tuple(places)

    def numbers(means: Means) -> Means:
        by_level = _over_tasks(means)
        of_all = [by_level.mean(axis=-1), interquartile_mean(by_level), tail_mean(by_level)]
        of_axes = [by_level[:, own].mean(axis=-1) for own in places.values()]
        return np.stack([*of_all, *of_axes], axis=-1)

    seed = int(content_hash(["overall", policy, simulator]), 16)
    mean, middle, tail, *by_axis = bootstrap(strata, numbers, np.random.default_rng(seed))
    worst = int(np.argmin([estimate.value for estimate in by_axis]))
    drawn = numbers(resampled_means(strata, np.random.default_rng(seed), DRAWS))[:, 3:]
    certainty = float((drawn.argmin(axis=-1) == worst).mean())
    return OverallRow(
        policy,
        simulator,
        len(levels),
        mean,
        middle,
        tail,
        WorstAxis(axes[worst], by_axis[worst], certainty),
    )


def _agreement(
    policy: str, one: str, other: str, sides: Sequence[Sequence[PlannedCell]], judged: Judged
) -> AgreementRow | None:
    found = [_losses(cells, judged, [policy, name]) for cells, name in zip(sides, (one, other), strict=True)]
    axes = [axis for axis in found[0] if axis in found[1]]
    if len(axes) < LEAST_AXES:
        return None
    # A pair of orders for each data set: the one that was seen, then those drawn.
    first, second = (np.array([losses[axis] for axis in axes]).T.tolist() for losses in found)
    violation = rank_violation(first[0], second[0])
    assert violation is not None  # there are axes
    tau, *drawn = map(kendall_tau, first, second)
    known = [value for value in drawn if value is not None]
    ends = Interval(*map(float, np.quantile(known, ENDS))) if len(known) == len(drawn) else None
    p = kendall_p(first[0], second[0])
    return AgreementRow(policy, one, other, len(axes), None if tau is None else Estimate(tau, ends), p, violation)


def _losses(cells: Sequence[PlannedCell], judged: Judged, named: Sequence[str]) -> Mapping[str, NDArray[np.float64]]:
    """Axis to what is lost of the clean rate at its levels, on average: as was seen, then in data sets drawn."""
    levels, strata = _outcomes(cells, judged, clean=True)
    lost = [outcomes[:, :1] - outcomes[:, 1:] for outcomes in strata]
    if not levels or any(np.isnan(losses).all() for losses in lost):
        return {}
    generator = np.random.default_rng(int(content_hash(["agreement", *named]), 16))
    means = np.concatenate([mean_outcomes(lost)[None], resampled_means(lost, generator, AGREEMENT_DRAWS)])
    by_level = _over_tasks(means)
    places = _places(levels)
    found = {axis: by_level[:, own].mean(axis=-1) for axis, own in places.items()}
    return {axis: losses for axis, losses in found.items() if not np.isnan(losses).any()}


def _places(levels: Sequence[Condition]) -> Mapping[str, list[int]]:
    """Axis to where its levels are."""
    axes = dict.fromkeys(level.axis for level in levels)
    return {axis: [i for i, level in enumerate(levels) if level.axis == axis] for axis in axes}


def _outcomes(
    cells: Sequence[PlannedCell], judged: Judged, *, clean: bool = False
) -> tuple[list[Condition], list[Outcomes]]:
    """The perturbed conditions that count in some task, and each task's outcomes, shape (seeds, conditions).

    With `clean` a first column holds the clean condition, which is not among those named.
    """
    levels = list(dict.fromkeys(Condition(cell.axis, cell.severity) for cell in cells if cell.axis != CLEAN))
    strata = judged.by_condition(cells, [Condition(), *levels])
    counts = [i for i in range(len(levels)) if any((~np.isnan(s[:, i + 1])).any() for s in strata)]
    columns = [0, *(i + 1 for i in counts)] if clean else [i + 1 for i in counts]
    return [levels[i] for i in counts], [s[:, columns] for s in strata]


def _over_tasks(means: Means) -> Means:
    """Mean over the tasks in which a level counts, shape (draws, levels)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a level that no seed drawn has
        return np.asarray(np.nanmean(means, axis=-2))
