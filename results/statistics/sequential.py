"""Evidence that may be looked at after every pair: a test and an interval that hold at whatever moment one stops.

Ville's inequality: a process that is an expected 1 at most under the null hypothesis, whenever it is looked at, exceeds
1 / alpha with a probability of at most alpha, ever. A test for a fixed number of pairs has no such guarantee: looked at
every ten pairs up to 400, McNemar's rejects a true null in a quarter of the runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from results.statistics.multiplicity import ALPHA
from results.statistics.pairs import Pairs
from results.statistics.rates import CONFIDENCE, Interval, check_confidence

GRID = 1000
"""Candidate means at which a confidence sequence is looked at, evenly over [0, 1]."""
LARGEST_BET = 0.5
"""Share of what could be lost at most that a bet risks (Waudby-Smith and Ramdas: c)."""


def paired_evidence(pairs: Pairs) -> float:
    """Evidence that one of two sides succeeds more often on the same trials: an e-value against equal rates.

    Of m pairs that disagree x are in favour of the first side. Under equal rates x is a fair coin's; betting on every
    coin by Beta(1/2, 1/2) gives

        E = 2^m B(x + 1/2, m - x + 1/2) / B(1/2, 1/2)

    the mixture likelihood ratio of R. Krichevsky and V. Trofimov (1981) as a test martingale (A. Ramdas et al., "Game-
    theoretic statistics and safe anytime-valid inference", Statistical Science 38 (2023)). Its expectation is 1 under
    the null after any number of pairs, so it may be watched and stopped at will. Two-sided: exchanging the sides leaves
    it as it is. Over several strata add up the pairs.

    Returns:
        The e-value, from 0; infinite where it exceeds the largest float.
    """
    logarithm = log_evidence(np.array([pairs.first_only]), np.array([pairs.second_only]))[0]
    return math.exp(logarithm) if logarithm < math.log(np.finfo(float).max) else math.inf


def log_evidence(first_only: NDArray[np.integer], second_only: NDArray[np.integer]) -> NDArray[np.float64]:
    """Natural logarithm of `paired_evidence` for many counts at once, each of shape (n,)."""
    from scipy.special import betaln

    x, y = np.asarray(first_only, dtype=float), np.asarray(second_only, dtype=float)
    found: NDArray[np.float64] = (x + y) * math.log(2.0) + betaln(x + 0.5, y + 0.5) - betaln(0.5, 0.5)
    return found


def is_decided(pairs: Pairs, alpha: float = ALPHA) -> bool:
    """Whether the evidence reaches 1 / alpha, so that the comparison may stop.

    Raises:
        ValueError: alpha outside (0, 1).
    """
    if not 0 < alpha < 1:
        raise ValueError(f"expected an alpha between 0 and 1, got {alpha}")
    return bool(log_evidence(np.array([pairs.first_only]), np.array([pairs.second_only]))[0] >= -math.log(alpha))


def anytime_mean(values: Sequence[float], confidence: float = CONFIDENCE) -> Interval:
    """Confidence interval of the mean of values in [0, 1], valid at whatever moment one stops looking.

    The hedged capital process of I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random variables by
    betting", J. R. Statist. Soc. B 86 (2024) 1-27, theorem 3, with predictable plug-in bets: the candidates m that have
    not yet earned 1 / alpha by half betting that the mean is above m and half that it is below. The running
    intersection is taken, so it never widens with more values.

    Args:
        values: In the order in which they came, each in [0, 1].
        confidence: Between 0 and 1, exclusive.

    Returns:
        The interval; [0, 1] without values.

    Raises:
        ValueError: A value outside [0, 1], or a confidence outside (0, 1).
    """
    check_confidence(confidence)
    x = np.asarray(values, dtype=float)
    if not np.all((x >= 0) & (x <= 1)):
        raise ValueError("expected values between 0 and 1, got others")
    if not len(x):
        return Interval(0.0, 1.0)
    candidates = np.linspace(0.0, 1.0, GRID + 1)
    alive = np.ones(GRID + 1, dtype=bool)
    above, below = np.zeros(GRID + 1), np.zeros(GRID + 1)
    with np.errstate(divide="ignore"):
        for value, bet in zip(x, _bets(x, 1 - confidence), strict=True):
            gain = value - candidates
            above += np.log1p(np.minimum(bet, LARGEST_BET / candidates) * gain)
            below += np.log1p(-np.minimum(bet, LARGEST_BET / (1 - candidates)) * gain)
            alive &= np.maximum(above, below) + math.log(0.5) < -math.log(1 - confidence)
    kept = candidates[alive]
    if not len(kept):  # the null model itself, independent values of one mean, is then all but impossible
        mean = float(x.mean())
        return Interval(mean, mean)
    step = 1.0 / GRID
    return Interval(max(0.0, float(kept[0]) - step), min(1.0, float(kept[-1]) + step))


def anytime_difference(differences: Sequence[int], confidence: float = CONFIDENCE) -> Interval:
    """Confidence interval of a difference of two rates on the same trials, valid at whatever moment one stops.

    Args:
        differences: First side minus second in each trial, as they came: -1, 0 or 1.
        confidence: Between 0 and 1, exclusive.

    Raises:
        ValueError: Another difference, or a confidence outside (0, 1).
    """
    found = anytime_mean([(difference + 1) / 2 for difference in differences], confidence)
    return Interval(2 * found.low - 1, 2 * found.high - 1)


def _bets(x: NDArray[np.float64], alpha: float) -> NDArray[np.float64]:
    """Predictable plug-in bets sqrt(2 log(2 / alpha) / (v t log(t + 1))), v the variance before t, shape (n,)."""
    t = np.arange(1, len(x) + 1)
    means = (0.5 + np.cumsum(x)) / (t + 1)
    variances = (0.25 + np.cumsum((x - means) ** 2)) / (t + 1)
    before = np.concatenate([[0.25], variances[:-1]])
    bets: NDArray[np.float64] = np.sqrt(2 * math.log(2 / alpha) / (before * t * np.log(t + 1)))
    return bets
