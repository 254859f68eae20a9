"""Means over many cells, means of the worst cells, and bootstrap intervals that keep pairs together."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.statistics.rates import CONFIDENCE, Estimate, Interval

DRAWS = 2000
WORST_SHARE = 0.2
"""Share of the values that `tail_mean` averages."""
MISSING = -1e300
"""Stands for an outcome without a verdict while trials are counted."""

Outcomes = NDArray[np.floating]
"""Shape (trials, arms): the outcome of each arm on the same trial, NaN where it has no verdict."""


def interquartile_mean(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Mean of the middle half along the last axis (IQM): a quarter of the values, rounded down, is cut on each side.

    R. Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice" (NeurIPS 2021), as rliable
    computes it. With fewer than eight values it is nearly a median.
    """
    from scipy.stats import trim_mean

    return np.asarray(trim_mean(values, proportiontocut=0.25, axis=-1))


def tail_mean(values: NDArray[np.floating]) -> NDArray[np.float64]:
    """Mean of the worst `WORST_SHARE` along the last axis, the number of values rounded up: CVaR.

    R. T. Rockafellar and S. Uryasev, J. Risk 2 (2000) 21-41, of a sample with equal weights.
    """
    worst = np.sort(np.asarray(values, dtype=float), axis=-1)
    count = max(1, math.ceil(WORST_SHARE * worst.shape[-1] - 1e-9))
    return np.asarray(np.take(worst, range(count), axis=-1).mean(axis=-1))


def resampled_means(
    strata: Sequence[Outcomes], generator: np.random.Generator, draws: int = DRAWS
) -> NDArray[np.float64]:
    """Mean outcomes of each arm in each stratum, in bootstrap samples: whole trials are drawn within each stratum.

    Arms of one trial stay together, so that comparisons of arms keep their pairing; strata are fixed, as tasks and
    simulators are. Of n trials n - 1 are drawn: n would make the intervals of small strata too narrow by a factor of
    sqrt((n - 1) / n) (P. J. McCarthy and C. B. Snowden, "The bootstrap and finite population sampling" 1985).

    Returns:
        Shape (draws, strata, arms); NaN where no trial drawn has a verdict.
    """
    found = np.empty((draws, len(strata), strata[0].shape[1] if strata else 0))
    for number, outcomes in enumerate(strata):
        # How often each kind of trial is drawn, not the trials themselves: one matrix product per stratum, and of
        # outcomes that are 0, 1 or missing there are few kinds.
        kinds, counts = np.unique(np.nan_to_num(outcomes, nan=MISSING), axis=0, return_counts=True)
        present = kinds != MISSING
        values = np.where(present, kinds, 0.0)
        drawn = max(len(outcomes) - 1, 1)
        times = generator.multinomial(drawn, counts / max(len(outcomes), 1), size=draws)
        with np.errstate(invalid="ignore"):
            found[:, number] = (times @ values) / (times @ present)
    return found


def mean_outcomes(strata: Sequence[Outcomes]) -> NDArray[np.float64]:
    """Mean outcome of each arm in each stratum, shape (strata, arms); NaN where there is no verdict."""
    with np.errstate(invalid="ignore"):
        sums = [np.nansum(outcomes, axis=0) / (~np.isnan(outcomes)).sum(axis=0) for outcomes in strata]
    return np.array(sums, dtype=float)


def mean_of_levels(strata: Sequence[Outcomes], confidence: float = CONFIDENCE) -> Estimate | None:
    """Mean over the arms of each arm's mean over the strata, with Student's interval for the spread of trials.

    An arm has the weight of any other, and so has each stratum with a value of it. The mean is linear in the trials, so
    each stratum's variance is that of its trials' weighted deviations; degrees of freedom are those of F. E.
    Satterthwaite, "An approximate distribution of estimates of variance components", Biometrics Bull. 2 (1946) 110-114.

    Args:
        strata: Numbers of each arm on each trial, shape (trials, arms), NaN where there is none.
        confidence: Of the interval.

    Returns:
        None without a number. Without an interval where all trials of each stratum are alike, or a stratum has one.
    """
    from scipy.stats import t

    kept = [outcomes[~np.isnan(outcomes).all(axis=1)] for outcomes in strata]
    kept = [outcomes for outcomes in kept if len(outcomes)]
    if not kept:
        return None
    means = mean_outcomes(kept)
    weights = (~np.isnan(means)).sum(axis=0)
    arms = weights > 0
    shares = 1 / (arms.sum() * weights[arms])
    value = float((np.nansum(means[:, arms], axis=0) * shares).sum())
    if any(len(outcomes) < 2 for outcomes in kept):
        return Estimate(value, None)
    variances, freedoms = [], []
    for outcomes, own in zip(kept, means, strict=True):
        counts = np.maximum((~np.isnan(outcomes)).sum(axis=0), 1)
        deviations = np.nansum(((outcomes - own) * (1 / counts))[:, arms] * shares, axis=1)
        freedoms.append(len(outcomes) - 1)
        variances.append(len(outcomes) / freedoms[-1] * float((deviations**2).sum()))
    whole = sum(variances)
    if whole <= 0:
        return Estimate(value, None)
    freedom = whole**2 / sum(one**2 / own for one, own in zip(variances, freedoms, strict=True))
    half = float(t.isf((1 - confidence) / 2, freedom)) * math.sqrt(whole)
    return Estimate(value, Interval(value - half, value + half))


def percentile_interval(
    drawn: NDArray[np.float64], confidence: float = CONFIDENCE, *, interpolate: bool = True
) -> Interval | None:
    """Percentile interval of a number's values in bootstrap samples, shape (draws,).

    B. Efron and R. J. Tibshirani, "An Introduction to the Bootstrap" (1993), chapters 8 and 13. With
    `resampled_means` it covers the spread of trials, not that of training, unless checkpoints are strata.

    Returns:
        None where a sample does not give the number, or all give the same: outcomes that are all alike show no spread
        however few they are.
    """
    if np.isnan(drawn).any() or drawn.max() == drawn.min():
        return None
    ends = [(1 - confidence) / 2, (1 + confidence) / 2]
    low, high = np.quantile(drawn, ends, method="linear" if interpolate else "inverted_cdf")
    return Interval(float(low), float(high))
