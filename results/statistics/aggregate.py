"""Means over many cells, with an interval that keeps the cells of a trial together."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.statistics.rates import CONFIDENCE, Estimate, Interval

Outcomes = NDArray[np.floating]
"""Shape (trials, arms): the outcome of each arm on the same trial, NaN where it has no verdict."""


def mean_outcomes(strata: Sequence[Outcomes]) -> NDArray[np.float64]:
    """Mean outcome of each arm in each stratum, shape (strata, arms); NaN where there is no verdict."""
    with np.errstate(invalid="ignore"):
        sums = [
            np.where(np.isnan(outcomes), 0.0, outcomes).sum(axis=0) / (~np.isnan(outcomes)).sum(axis=0)
            for outcomes in strata
        ]
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
    from scipy.special import stdtrit

    kept = [outcomes[~np.isnan(outcomes).all(axis=1)] for outcomes in strata]
    kept = [outcomes for outcomes in kept if len(outcomes)]
    if not kept:
        return None
    means = mean_outcomes(kept)
    weights = (~np.isnan(means)).sum(axis=0)
    shares = np.where(weights > 0, 1 / (np.count_nonzero(weights) * np.maximum(weights, 1)), 0.0)
    value = float(np.nan_to_num(means).sum(axis=0) @ shares)
    if any(len(outcomes) < 2 for outcomes in kept):
        return Estimate(value, None)
    variances, freedoms = [], [len(outcomes) - 1 for outcomes in kept]
    for outcomes, own, count in zip(kept, means, freedoms, strict=True):
        present = ~np.isnan(outcomes)
        deviations = np.where(present, outcomes - own, 0.0) @ (shares / np.maximum(present.sum(axis=0), 1))
        variances.append(len(outcomes) / count * float(deviations @ deviations))
    whole = sum(variances)
    if whole <= 0:
        return Estimate(value, None)
    freedom = whole**2 / sum(one**2 / own for one, own in zip(variances, freedoms, strict=True))
    half = float(stdtrit(freedom, (1 + confidence) / 2)) * math.sqrt(whole)
    return Estimate(value, Interval(value - half, value + half))
