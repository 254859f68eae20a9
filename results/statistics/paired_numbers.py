"""Differences of a number that two sides have on the same trials: median and signed-rank test."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.statistics.aggregate import DRAWS, percentile_interval
from robogauntlet.results.statistics.rates import CONFIDENCE, Estimate

AT_ONCE = 4_000_000
"""Numbers in memory at a time."""


def median_difference(
    differences: NDArray[np.floating],
    strata: NDArray[np.integer],
    generator: np.random.Generator,
    confidence: float = CONFIDENCE,
    draws: int = DRAWS,
) -> Estimate:
    """Median of differences, with a percentile interval of a bootstrap that draws trials within each stratum.

    Strata are fixed, as tasks are; see `aggregate.resampled_means`. Trials must be independent: those that start alike
    are one trial.

    Args:
        differences: First side minus second, shape (trials,), at least one.
        strata: Number of each trial's stratum, shape (trials,).
        generator: Draws the samples.
        confidence: Of the interval.
        draws: Number of samples.

    Returns:
        The estimate; without an interval if all samples have the same median.
    """
    places = [np.flatnonzero(strata == stratum) for stratum in np.unique(strata)]
    medians = []
    for start in range(0, draws, size := max(1, AT_ONCE // len(differences))):
        shape = min(size, draws - start)
        drawn = [own[generator.integers(len(own), size=(shape, len(own)))] for own in places]
        medians.append(np.median(differences[np.concatenate(drawn, axis=1)], axis=1))
    return Estimate(float(np.median(differences)), percentile_interval(np.concatenate(medians), confidence))


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
