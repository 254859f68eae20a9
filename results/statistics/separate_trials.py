"""Two sides on separate trials, which are not paired."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

NEGLIGIBLE = 1e-30
"""Probability below which an outcome of a stratum is left out."""
SLACK = 1e-7
"""Relative difference of two probabilities that counts as none."""


@dataclass(frozen=True, slots=True)
class Separate:
    """Outcomes of two sides in a stratum, counted."""

    first: int
    """Successes of the first side."""
    first_trials: int
    second: int
    second_trials: int


def fisher(strata: Iterable[Separate]) -> float:
    """Two-sided exact p-value against equal odds of success of both sides in every stratum.

    Given the successes of both sides together in each stratum, those of the first side are the sum of hypergeometric
    numbers; the p-value is the probability of all sums that are no more probable than the observed one. Of one stratum
    it is Fisher's test, of several the exact test of M. H. Gail and N. Mantel, Journal of the American Statistical
    Association 72 (1977) 859-862. 1 without a stratum.
    """
    import numpy as np
    from scipy.stats import hypergeom

    probabilities, observed = np.ones(1), 0
    for one in strata:
        total = one.first + one.second
        least, most = max(0, total - one.second_trials), min(total, one.first_trials)
        counts = np.arange(least, most + 1)
        own = hypergeom.pmf(counts, one.first_trials + one.second_trials, total, one.first_trials)
        kept = np.flatnonzero(own > NEGLIGIBLE)
        observed += one.first - least - int(kept[0])
        probabilities = np.convolve(probabilities, own[kept[0] : kept[-1] + 1])
    if not 0 <= observed < len(probabilities):
        return 0.0
    return float(min(1.0, probabilities[probabilities <= probabilities[observed] * (1 + SLACK)].sum()))
