"""Success rates and their intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

CONFIDENCE = 0.95
"""Default probability with which an interval covers the true rate."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval: of a rate within [0, 1], of a difference of rates within [-1, 1]."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its confidence interval."""

    value: float
    interval: Interval | None
    """None where the data do not give one."""


@dataclass(frozen=True, slots=True)
class RateBounds:
    """What a rate can be when some trials have no verdict: all of them fail, or all of them succeed."""

    low: float
    """Rate if every trial without verdict had failed."""
    high: float
    """Rate if every trial without verdict had succeeded."""
    interval: Interval
    """From the lower Wilson end of `low` to the upper Wilson end of `high`."""


def rate_difference(
    first: tuple[float, float], second: tuple[float, float], share: float = 1.0, confidence: float = CONFIDENCE
) -> Estimate | None:
    """Rate of the first side minus a share of that of the second, each given as (successes, trials), with an interval.

    With Wilson's intervals (l1, u1) and (l2, u2) of the rates p1 and p2 and the share f, its ends are p1 - f p2 -
    sqrt((p1 - l1)² + f² (u2 - p2)²) and p1 - f p2 + sqrt((u1 - p1)² + f² (p2 - l2)²): G. Y. Zou and A. Donner,
    "Construction of confidence limits about effect measures", Statistics in Medicine 27 (2008) 1693-1702. For f = 1 it
    is method 10 of R. G. Newcombe, Statistics in Medicine 17 (1998) 873-890. None if a side has no trials.
    """
    one, other = wilson_intervals([first[0], second[0]], [first[1], second[1]], confidence)
    if one is None or other is None:
        return None
    p1, p2 = first[0] / first[1], second[0] / second[1]
    value = p1 - share * p2
    below = math.hypot(p1 - one.low, share * (other.high - p2))
    above = math.hypot(one.high - p1, share * (p2 - other.low))
    return Estimate(value, Interval(value - below, value + above))


@lru_cache(maxsize=1 << 16)  # Pages need the same ones many times.
def wilson_interval(successes: int, trials: int, confidence: float = CONFIDENCE) -> Interval | None:
    """Wilson score interval of a rate.

    With p = successes / trials, n = trials and z the normal quantile of (1 + confidence) / 2, its ends are
    (p + z²/2n ± z sqrt(p(1 - p)/n + z²/4n²)) / (1 + z²/n): E. B. Wilson, "Probable inference, the law of succession,
    and statistical inference", JASA 22 (1927), as recommended by Brown, Cai and DasGupta (2001) for small n.

    Returns:
        The interval, or None without trials (episodes with a verdict).

    Raises:
        ValueError: The counts are not 0 <= successes <= trials, or the confidence is outside (0, 1).
    """
    return wilson_intervals([successes], [trials], confidence)[0]


def wilson_intervals(
    successes: Sequence[float], trials: Sequence[float], confidence: float = CONFIDENCE
) -> list[Interval | None]:
    """`wilson_interval` for many rates at once: two sequences of counts of one length, one interval (or None) each."""
    import numpy as np

    if not 0 < confidence < 1:
        raise ValueError(f"expected a confidence between 0 and 1, got {confidence}")
    k, n = np.asarray(successes, dtype=float), np.asarray(trials, dtype=float)
    if k.shape != n.shape or k.ndim != 1:
        raise ValueError(f"expected as many successes as trials, got shapes {k.shape} and {n.shape}")
    if not np.all((k >= 0) & (k <= n)):
        raise ValueError("expected 0 <= successes <= trials")
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    divisor = np.maximum(n, 1.0)
    p, shrinkage = k / divisor, z**2 / divisor
    centre = (p + shrinkage / 2) / (1 + shrinkage)
    half = np.sqrt(p * (1 - p) * shrinkage + shrinkage**2 / 4) / (1 + shrinkage)
    # The formula gives exactly 0 and 1 at the extremes, floating point arithmetic does not.
    low = np.where(k == 0, 0.0, np.maximum(centre - half, 0.0)).tolist()
    high = np.where(k == n, 1.0, np.minimum(centre + half, 1.0)).tolist()
    return [Interval(*ends) if some else None for *ends, some in zip(low, high, n > 0, strict=True)]


def rate(successes: int, trials: int) -> float | None:
    """Successes per trial, or None without trials."""
    return successes / trials if trials else None


def rate_bounds(successes: int, failures: int, without_verdict: int) -> RateBounds | None:
    """Lowest and highest rate that trials without a verdict allow (worst-case bounds, C. F. Manski 1989).

    Args:
        successes: Trials that succeeded.
        failures: Trials that failed.
        without_verdict: Trials that ended in an error or were not run.

    Returns:
        The bounds, or None without trials.
    """
    total, best = successes + failures + without_verdict, successes + without_verdict
    worst_interval, best_interval = wilson_intervals([successes, best], [total, total])
    if worst_interval is None or best_interval is None:
        return None
    return RateBounds(successes / total, best / total, Interval(worst_interval.low, best_interval.high))


def clustered_rate(outcomes: NDArray[np.floating], points: NDArray[np.integer], seeds: NDArray[np.integer]) -> Estimate:
    """The mean of outcomes of points that are played at the same seeds, with Wilson's interval.

    The interval is that of as many independent trials as are equally informative: the number of trials divided by the
    design effect (E. L. Korn and B. I. Graubard, Survey Methodology 24 (1998) 193-201). The variance is that of a rate
    with two crossed clusters, between points plus between seeds less that of single trials (A. C. Cameron, J. B.
    Gelbach and D. L. Miller, J. Bus. Econ. Stat. 29 (2011) 238-249), with Student's quantile for few seeds or points.

    Args:
        outcomes: 0 or 1, shape (trials,), at least one.
        points: Number of each trial's point, shape (trials,).
        seeds: Number of each trial's seed, shape (trials,); of its task and seed where there are several tasks.
    """
    import numpy as np
    from scipy.special import stdtrit

    values = np.asarray(outcomes, dtype=float)
    trials, rate = len(values), float(values.mean())
    parts, groups = [], []
    for clusters in (points, seeds):
        numbers = np.unique(clusters, return_inverse=True)[1].reshape(-1)
        count = int(numbers.max()) + 1
        parts.append(float((np.bincount(numbers, values - rate) ** 2).sum()) * count / max(1, count - 1))
        groups.append(count)
    effect = max(1.0, trials / max(groups))
    if 0 < rate < 1:
        single = trials * rate * (1 - rate)
        excess = [max(0.0, part - single) if count > 1 else 0.0 for part, count in zip(parts, groups, strict=True)]
        variance = single + sum(excess)
        freedom = variance**2 / sum(
            share**2 / max(1, count - 1) for share, count in zip((single, *excess), (trials, *groups), strict=True)
        )
        quantile = NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
        effect = max(1.0, variance / single * (float(stdtrit(freedom, (1 + CONFIDENCE) / 2)) / quantile) ** 2)
    (interval,) = wilson_intervals([values.sum() / effect], [trials / effect])
    return Estimate(rate, interval)
