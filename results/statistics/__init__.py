"""Statistics of episodes: counts and outcomes in, frozen values out. No state, no global random generator.

Whatever scipy or statsmodels has is theirs; they are imported where they are used, so that this loads in milliseconds.
"""

from results.statistics.pairs import Pairs, paired_difference, paired_ratio
from results.statistics.rates import (
    CONFIDENCE,
    Estimate,
    Interval,
    RateBounds,
    rate,
    rate_bounds,
    wilson_interval,
    wilson_intervals,
)

__all__ = [
    "CONFIDENCE",
    "Estimate",
    "Interval",
    "Pairs",
    "RateBounds",
    "paired_difference",
    "paired_ratio",
    "rate",
    "rate_bounds",
    "wilson_interval",
    "wilson_intervals",
]
