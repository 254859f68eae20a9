"""Effects of a perturbation's severity: retention, the area under its curve, where half is lost, and the trend."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.statistics.aggregate import Outcomes, mean_of_levels, mean_outcomes
from robogauntlet.results.statistics.pairs import Pairs, paired_difference, pooled
from robogauntlet.results.statistics.rates import Estimate, Interval, wilson_interval, wilson_intervals

LEAST_CLEAN = 0.2
"""Retention is computed only if the clean rate is shown to exceed this."""
HALF = 0.5


@dataclass(frozen=True, slots=True)
class SeverityCurve:
    """Success of one arm along one axis. Strata (tasks, simulators) have equal weight."""

    levels: tuple[float, ...]
    """From 0, the clean condition."""
    rates: tuple[Estimate, ...]
    """p(s)."""
    drops: tuple[Estimate, ...]
    """p(0) - p(s) over the seeds with a verdict at both, 0 at level 0."""
    retention: tuple[float, ...] | None
    """p(s) / p(0), baselines subtracted from both; None where the clean rate is too low, see `LEAST_CLEAN`."""
    area: Estimate | None
    """Area under the retention, divided by the range of levels: 1 if nothing is lost. Not clipped."""
    half: float | None
    """Severity at which half is lost; infinite where that is beyond the last level."""
    trend: float | None
    """One-sided p-value against no fall of success with severity. It, area and half are None for kinds of change."""


def severity_curve(
    strata: Sequence[Outcomes],
    levels: Sequence[float],
    *,
    baselines: Sequence[float] | None = None,
    ordered: bool = True,
) -> SeverityCurve:
    """The curve of one arm.

    Rates have Wilson's interval, drops Newcombe's paired one, and the area Student's for the spread of seeds.

    Args:
        strata: Outcomes of each task, shape (seeds, levels), NaN where there is no verdict.
        levels: Severities, rising from 0.
        baselines: Success of the best no-skill baseline at each level, subtracted before anything is divided.
        ordered: Whether a higher level is more of the same.

    Raises:
        ValueError: Levels that do not rise from 0, or outcomes or baselines of another length.
    """
    steps = np.asarray(levels, dtype=float)
    if len(steps) < 2 or steps[0] != 0 or not np.all(np.diff(steps) > 0):
        raise ValueError(f"expected levels that rise from 0, got {list(levels)}")
    if not strata or any(outcomes.ndim != 2 or outcomes.shape[1] != len(steps) for outcomes in strata):
        raise ValueError(f"expected outcomes of shape (seeds, {len(steps)}), got others")
    base = np.zeros(len(steps)) if baselines is None else np.asarray(baselines, dtype=float)
    if base.shape != steps.shape:
        raise ValueError(f"expected a floor for each of {len(steps)} levels, got {len(base)}")
    means = mean_outcomes(strata)
    clean = np.concatenate([outcomes[:, 0] for outcomes in strata])
    clean = clean[~np.isnan(clean)]
    ends = wilson_interval(int(clean.sum()), len(clean))
    kept = surface = half = None
    if ends is not None and ends.low > LEAST_CLEAN:
        kept, whole = retention(means, base)
        if ordered:
            surface, half = _area(strata, steps, kept, whole), float(half_lost(kept, steps))
    return SeverityCurve(
        levels=tuple(steps.tolist()),
        rates=tuple(_rate(strata, level, means[:, level]) for level in range(len(steps))),
        drops=tuple(_drop(strata, level) for level in range(len(steps))),
        retention=None if kept is None else tuple(kept.tolist()),
        area=surface,
        half=half,
        trend=falling_trend(strata, steps) if ordered else None,
    )


def retention(
    rates: NDArray[np.float64], baselines: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(p(s) - f(s)) / (p(0) - f(0)), means over the strata that have a rate at level s.

    A stratum without a rate at s, such as a task in which the oracle fails, is left out of the clean rate too.

    Args:
        rates: Shape (..., strata, levels), NaN where there is none.
        baselines: Shape (levels,).

    Returns:
        The retention, NaN where there is nothing to retain, and what is divided by; each of shape (..., levels).
    """
    above = rates - baselines
    clean = np.where(np.isnan(above), np.nan, above[..., :1])
    tasks = np.maximum((~np.isnan(clean)).sum(axis=-2), 1)
    left, whole = np.nansum(above, axis=-2) / tasks, np.nansum(clean, axis=-2) / tasks
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(whole > 0, left / whole, np.nan), whole


def area(kept: NDArray[np.float64], levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Area under the retention along the last axis by trapezoids, divided by the range of levels."""
    # SciPy's function of that name is the same sum; importing it takes half a second of every command that plays.
    trapezoids = np.diff(levels) * (kept[..., 1:] + kept[..., :-1]) / 2.0
    found: NDArray[np.float64] = trapezoids.sum(axis=-1) / (levels[-1] - levels[0])
    return found


def half_lost(kept: NDArray[np.float64], levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Severity at which a falling fit of the retention crosses one half (S50), between levels by straight lines.

    The fit is the least-squares one that never rises (pool adjacent violators: R. E. Barlow et al., "Statistical
    Inference under Order Restrictions" (1972)).

    Args:
        kept: Retention at each level, shape (..., levels).
        levels: Rising.

    Returns:
        The severities, shape (...); infinite if more than half is kept at the last level; NaN without a retention.
    """
    from scipy.optimize import isotonic_regression

    fits = kept.reshape(-1, len(levels)).copy()
    unknown = np.isnan(fits).any(axis=1)
    for rising in np.flatnonzero((np.diff(fits) > 0).any(axis=1) & ~unknown):  # the others are their own fits
        fits[rising] = isotonic_regression(fits[rising], increasing=False).x
    after = np.argmax(fits <= HALF, axis=1)
    before, row = np.maximum(after - 1, 0), np.arange(len(fits))
    with np.errstate(divide="ignore", invalid="ignore"):  # where no level is before
        share = (fits[row, before] - HALF) / (fits[row, before] - fits[row, after])
        found = levels[before] + share * (levels[after] - levels[before])
    found = np.select([unknown, fits[:, -1] > HALF, after == 0], [np.nan, np.inf, levels[0]], found)
    severities: NDArray[np.float64] = found.reshape(kept.shape[:-1])
    return severities


def falling_trend(strata: Sequence[Outcomes], levels: NDArray[np.float64]) -> float | None:
    """One-sided p-value against no fall of success with severity, given each seed's own number of successes.

    Conditional on the number of successes of a seed, all orders of its outcomes are equally likely under the null: the
    sum of the levels of its successes has a known mean and variance, and the sum over all seeds is nearly normal (the
    stratified trend test of W. G. Cochran (1954) and P. Armitage (1955), with seeds as strata; E. B. Page's test for
    binary outcomes).

    Returns:
        The p-value, or None if no seed has both outcomes.
    """
    from scipy.stats import norm

    excess, variance = 0.0, 0.0
    for outcomes in strata:
        present = ~np.isnan(outcomes)
        count = present.sum(axis=1)
        won = np.nansum(outcomes, axis=1)
        mixed = (won > 0) & (won < count)
        if not mixed.any():
            continue
        here, wins, n, y = present[mixed], won[mixed], count[mixed], np.nan_to_num(outcomes[mixed])
        mean = (here * levels).sum(axis=1) / n
        spread = (here * (levels - mean[:, None]) ** 2).sum(axis=1) / n
        excess += float((y @ levels - wins * mean).sum())
        variance += float((wins * (n - wins) / (n - 1) * spread).sum())
    return float(norm.cdf(excess / math.sqrt(variance))) if variance > 0 else None


def _rate(strata: Sequence[Outcomes], level: int, means: NDArray[np.float64]) -> Estimate:
    """Mean of the strata that have a rate at a level, and Wilson's interval of as many trials as have its variance.

    Strata of unequal size count as (sum of their weights)² / (sum of weights² / size) trials: L. Kish, "Survey
    Sampling" (1965). Between strata that differ, trials vary less than that; the interval is conservative then.
    """
    sizes = np.array([(~np.isnan(outcomes[:, level])).sum() for outcomes in strata])
    sizes = sizes[sizes > 0]
    if not len(sizes):
        return Estimate(math.nan, None)
    value, trials = float(np.nanmean(means)), len(sizes) ** 2 / float((1 / sizes).sum())
    return Estimate(value, wilson_intervals([min(value, 1.0) * trials], [trials])[0])


def _drop(strata: Sequence[Outcomes], level: int) -> Estimate:
    found = paired_difference(pooled(Pairs.from_outcomes(o[:, 0], o[:, level]) for o in strata))
    if found is None:
        return Estimate(math.nan, None)
    return found if level else Estimate(0.0, None)


def _area(
    strata: Sequence[Outcomes], levels: NDArray[np.float64], kept: NDArray[np.float64], whole: NDArray[np.float64]
) -> Estimate:
    """Area with Student's interval, linearised: a seed moves a retention `kept` by (p(s) - kept p(0)) / `whole`.

    The approximation is that of ratio estimates: W. G. Cochran, "Sampling Techniques" (1977), chapter 6.
    """
    value = float(area(kept, levels))
    if math.isnan(value):
        return Estimate(value, None)
    shares = len(levels) * area(np.eye(len(levels)), levels) / whole
    moved = mean_of_levels([shares * (outcomes - kept * outcomes[:, :1]) for outcomes in strata])
    if moved is None or moved.interval is None:
        return Estimate(value, None)
    half = (moved.interval.high - moved.interval.low) / 2
    return Estimate(value, Interval(value - half, value + half))
