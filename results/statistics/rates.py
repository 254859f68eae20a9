"""Success rates and their intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

CONFIDENCE = 0.95
"""Probability with which an interval covers the true rate, unless another is asked for."""


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


@lru_cache(maxsize=1 << 16)  # pages ask for the same ones again and again
def wilson_interval(successes: int, trials: int, confidence: float = CONFIDENCE) -> Interval | None:
    """Wilson score interval of a rate.

    With p = successes / trials, n = trials and z the normal quantile of (1 + confidence) / 2, its ends are
    (p + z²/2n ± z sqrt(p(1 - p)/n + z²/4n²)) / (1 + z²/n): E. B. Wilson, "Probable inference, the law of succession,
    and statistical inference", JASA 22 (1927), as recommended by Brown, Cai and DasGupta (2001) for small n.

    Args:
        successes: Between 0 and `trials`.
        trials: Episodes with a verdict.
        confidence: Between 0 and 1, exclusive.

    Returns:
        The interval, or None without trials.

    Raises:
        ValueError: The counts are not 0 <= successes <= trials, or the confidence is outside (0, 1).
    """
    return wilson_intervals([successes], [trials], confidence)[0]


def wilson_intervals(
    successes: Sequence[int], trials: Sequence[int], confidence: float = CONFIDENCE
) -> list[Interval | None]:
    """`wilson_interval` for many rates at once: two sequences of counts of one length, one interval (or None) each."""
    import numpy as np
    from statsmodels.stats.proportion import proportion_confint

    check_confidence(confidence)
    k, n = np.asarray(successes, dtype=float), np.asarray(trials, dtype=float)
    if k.shape != n.shape or k.ndim != 1:
        raise ValueError(f"expected as many successes as trials, got shapes {k.shape} and {n.shape}")
    if not np.all((k >= 0) & (k <= n)):
        raise ValueError("expected 0 <= successes <= trials")
    some = n > 0
    low, high = np.zeros_like(k), np.ones_like(k)
    if some.any():
        low[some], high[some] = proportion_confint(k[some], n[some], alpha=1 - confidence, method="wilson")
    # The formula gives exactly 0 and 1 at the extremes, floating point arithmetic does not.
    low, high = np.where(k == 0, 0.0, np.maximum(low, 0.0)), np.where(k == n, 1.0, np.minimum(high, 1.0))
    return [Interval(float(a), float(b)) if present else None for a, b, present in zip(low, high, some, strict=True)]


def clopper_pearson_interval(successes: int, trials: int, confidence: float = CONFIDENCE) -> Interval | None:
    """Interval of a rate that never covers with less than the confidence, for claims of "at least p".

    Its ends are those rates under which as many successes or more, and as few or fewer, have a probability of
    (1 - confidence) / 2 each: C. J. Clopper and E. S. Pearson, Biometrika 26 (1934) 404-413. Wider than Wilson's, whose
    coverage is right on average only. Each end alone is a bound with a confidence of (1 + confidence) / 2.

    Args:
        successes: Between 0 and `trials`.
        trials: Episodes with a verdict.
        confidence: Between 0 and 1, exclusive.

    Returns:
        The interval, or None without trials.

    Raises:
        ValueError: The counts are not 0 <= successes <= trials, or the confidence is outside (0, 1).
    """
    from statsmodels.stats.proportion import proportion_confint

    check_confidence(confidence)
    if not 0 <= successes <= trials:
        raise ValueError("expected 0 <= successes <= trials")
    if not trials:
        return None
    low, high = proportion_confint(successes, trials, alpha=1 - confidence, method="beta")
    return Interval(float(low) if successes else 0.0, float(high) if successes < trials else 1.0)


def rate(successes: int, trials: int) -> float | None:
    """Successes per trial, or None without trials."""
    return successes / trials if trials else None


def rate_bounds(
    successes: int, failures: int, without_verdict: int, confidence: float = CONFIDENCE
) -> RateBounds | None:
    """The least and the greatest rate that trials without a verdict allow (worst-case bounds, C. F. Manski 1989).

    Args:
        successes: Trials that succeeded.
        failures: Trials that failed.
        without_verdict: Trials that ended in an error or were not run.
        confidence: Of the interval, between 0 and 1, exclusive.

    Returns:
        The bounds, or None if there is no trial at all.

    Raises:
        ValueError: A count is negative, or the confidence is outside (0, 1).
    """
    check_confidence(confidence)
    if min(successes, failures, without_verdict) < 0:
        raise ValueError(f"expected counts, got {successes}, {failures} and {without_verdict}")
    total = successes + failures + without_verdict
    if not total:
        return None
    best = successes + without_verdict
    worst_interval, best_interval = wilson_intervals([successes, best], [total, total], confidence)
    assert worst_interval is not None  # there is a trial
    assert best_interval is not None
    return RateBounds(successes / total, best / total, Interval(worst_interval.low, best_interval.high))


def check_confidence(confidence: float) -> None:
    """Raises ValueError for a confidence outside (0, 1)."""
    if not 0 < confidence < 1:
        raise ValueError(f"expected a confidence between 0 and 1, got {confidence}")
