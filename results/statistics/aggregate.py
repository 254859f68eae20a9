"""Many cells as one number: middle mean, worst cases, and their intervals by a bootstrap that keeps pairs together."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.statistics.rates import CONFIDENCE, Estimate, Interval, check_confidence

DRAWS = 2000
WORST_SHARE = 0.2
"""Share of the cells that `tail_mean` looks at, unless another is asked for."""

MISSING = -1e300
"""Stands for an outcome without a verdict while trials are counted."""

Outcomes = NDArray[np.floating]
"""Shape (trials, arms): the outcome of each arm on the same trial, NaN where it has no verdict."""


def interquartile_mean(values: NDArray[np.floating], axis: int = -1) -> NDArray[np.float64]:
    """Mean of the middle half along an axis (IQM): a quarter of the values, rounded down, is left out on each side.

    R. Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice" (NeurIPS 2021), as rliable
    computes it. With fewer than eight values it is nearly a median.
    """
    from scipy.stats import trim_mean

    found: NDArray[np.float64] = np.asarray(trim_mean(values, proportiontocut=0.25, axis=axis))
    return found


def tail_mean(values: NDArray[np.floating], share: float = WORST_SHARE, axis: int = -1) -> NDArray[np.float64]:
    """Mean of the worst share along an axis, the number of values rounded up: the conditional value at risk (CVaR).

    R. T. Rockafellar and S. Uryasev, J. Risk 2 (2000) 21-41, of a sample with equal weights.

    Raises:
        ValueError: A share outside (0, 1].
    """
    if not 0 < share <= 1:
        raise ValueError(f"expected a share in (0, 1], got {share}")
    worst = np.sort(np.asarray(values, dtype=float), axis=axis)
    count = max(1, math.ceil(share * worst.shape[axis] - 1e-9))
    found: NDArray[np.float64] = np.asarray(np.take(worst, range(count), axis=axis).mean(axis=axis))
    return found


def resampled_means(
    strata: Sequence[Outcomes], generator: np.random.Generator, draws: int = DRAWS
) -> NDArray[np.float64]:
    """Mean outcomes of each arm in each stratum, in data sets drawn anew: whole trials, within each stratum.

    Arms of one trial stay together, so that comparisons of arms keep their pairing; strata are fixed, as tasks and
    simulators are. Of n trials n - 1 are drawn: as many as n would make the intervals of small strata too narrow, by a
    factor of sqrt((n - 1) / n) (P. J. McCarthy and C. B. Snowden, "The bootstrap and finite population sampling" 1985).

    Args:
        strata: Each of shape (trials, arms), the same number of arms in all.
        generator: Draws; the same state gives the same data sets.
        draws: Data sets.

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


def percentile_estimates(
    values: NDArray[np.float64], drawn: NDArray[np.float64], confidence: float = CONFIDENCE
) -> list[Estimate]:
    """Numbers with the percentile intervals of a stratified paired bootstrap, see `resampled_means`.

    B. Efron and R. J. Tibshirani, "An Introduction to the Bootstrap" (1993), chapters 8 and 13. It knows the spread of
    trials only: that of training is not in it unless checkpoints are strata of their own.

    Args:
        values: Of the data, shape (numbers,).
        drawn: Of data sets drawn from it, shape (draws, numbers).
        confidence: Between 0 and 1, exclusive.

    Returns:
        One estimate per number. It has no interval where a data set drawn does not give the number, or all give the
        same: outcomes that are all alike show no spread however few they are.

    Raises:
        ValueError: The confidence is outside (0, 1).
    """
    check_confidence(confidence)
    ends = np.quantile(drawn, [(1 - confidence) / 2, (1 + confidence) / 2], axis=0)
    known = ~np.isnan(drawn).any(axis=0) & (np.ptp(drawn, axis=0) > 0)
    return [
        Estimate(float(value), Interval(float(low), float(high)) if spread else None)
        for value, low, high, spread in zip(values, *ends, known, strict=True)
    ]
