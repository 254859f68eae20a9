"""Differences of a number that two sides have on the same trials: median and signed-rank test."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.statistics.rates import CONFIDENCE, Estimate, Interval


def median_difference(differences: NDArray[np.floating], confidence: float = CONFIDENCE) -> Estimate:
    """Median of differences, with the interval that the sign test gives.

    Its ends are two of the differences, chosen by the binomial distribution, so that it holds for any distribution and
    any number of trials (W. J. Conover, "Practical Nonparametric Statistics" (1999), section 3.2). Trials must be
    independent: those that start alike are one trial.

    Args:
        differences: First side minus second, shape (trials,), at least one.
        confidence: Of the interval.

    Returns:
        The estimate; without an interval where trials are too few for this confidence.
    """
    from scipy.stats import quantile_test

    low, high = quantile_test(differences, p=0.5).confidence_interval(confidence)
    known = math.isfinite(low) and math.isfinite(high)
    return Estimate(float(np.median(differences)), Interval(float(low), float(high)) if known else None)


def signed_rank(differences: NDArray[np.floating]) -> float:
    """Two-sided p-value of Wilcoxon's signed-rank test against differences that are symmetric about 0.

    F. Wilcoxon, "Individual comparisons by ranking methods", Biometrics Bull. 1 (1945) 80-83. Differences of 0 are left
    out; without any other, the p-value is 1.
    """
    from scipy.stats import wilcoxon

    other = differences[differences != 0]
    return float(wilcoxon(other).pvalue) if len(other) else 1.0


def can_reject_symmetry(differences: NDArray[np.floating], alpha: float) -> bool:
    """Whether `signed_rank` could reach alpha if all differences other than 0 were of one sign."""
    return int(np.count_nonzero(differences)) >= 1 - math.log2(alpha)
