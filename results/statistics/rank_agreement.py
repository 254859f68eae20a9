"""Agreement of two simulators, or of a simulator and robots, on an order, and the cost of a wrong order."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from robogauntlet.results.statistics.rates import Interval, rate_difference


def pearson(one: Sequence[float], other: Sequence[float]) -> float | None:
    """Pearson's correlation of the scores of the same items, from -1 to 1.

    Returns:
        None with fewer than two items, or where one side ties all of them.
    """
    a, b = (np.asarray(side, dtype=float) - np.mean(side) for side in (one, other))
    spread = math.sqrt(float(a @ a) * float(b @ b))
    return max(-1.0, min(1.0, float(a @ b) / spread)) if spread else None


def kendall(one: Sequence[float], other: Sequence[float]) -> tuple[float, float] | None:
    """Agreement in order of the same items scored twice, from -1 to 1, and its one-sided p-value.

    Tau-b of M. G. Kendall, Biometrika 33 (1945) 239-251, which corrects for ties. The p-value is against independent
    orders of a sample of items: exact by permutations without ties, else by the normal approximation (scipy).

    Returns:
        None with fewer than two items, or where one side ties all of them.
    """
    from scipy.stats import kendalltau

    found = kendalltau(one, other, alternative="greater")
    return None if math.isnan(found.statistic) else (float(found.statistic), float(found.pvalue))


def rank_violation(one: Sequence[float], other: Sequence[float]) -> float:
    """Mean maximum rank violation (MMRV): the largest cost of a disagreement in order, averaged over the items.

    mean_i max_j |one_i - one_j| 1[(other_i < other_j) != (one_i < one_j)], X. Li et al., "Evaluating real-world robot
    manipulation policies in simulation" (arXiv 2405.05941) equation 1; the first side is the one that counts. 0 is
    perfect agreement.
    """
    a, b = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    violated = (a[:, None] < a) != (b[:, None] < b)
    return float(np.max(np.abs(a[:, None] - a) * violated, axis=1).mean())


def agreement_bounds(one: Sequence[Interval], other: Sequence[Interval], items: int) -> tuple[Interval, Interval]:
    """Bounds of `kendall` and of `rank_violation` of the true scores of two or more items.

    A pair of items is in the same order, or in opposite ones, if its intervals on both sides exclude 0; each other pair
    may be either, or tied. If all intervals hold at once with some probability, so do the bounds, with at least that.

    Args:
        one: Intervals of score i minus score j on the first side, for each pair (i, j) of `combinations(range(items),
            2)`.
        other: Those on the second side.
        items: Number of items.
    """
    least, most = [0.0] * items, [0.0] * items
    same = opposite = 0
    for pair, first, second in zip(combinations(range(items), 2), one, other, strict=True):
        order = _sign(first) * _sign(second)
        same, opposite = same + (order > 0), opposite + (order < 0)
        ends = sorted((abs(first.low), abs(first.high)))
        for item in pair:
            least[item] = max(least[item], ends[0] if order < 0 else 0.0)
            most[item] = max(most[item], 0.0 if order > 0 else ends[1])
    pairs = len(one)
    tau = Interval(2 * same / pairs - 1, 1 - 2 * opposite / pairs)
    return tau, Interval(sum(least) / items, sum(most) / items)


def rate_agreement_bounds(
    one: Sequence[tuple[float, float]], other: Sequence[tuple[float, float]], confidence: float
) -> tuple[Interval, Interval]:
    """`agreement_bounds` of success rates, given as (successes, trials) of each item on both sides.

    They hold with at least this confidence: the intervals of all differences (Newcombe) are Bonferroni's. Items count
    as independent; where they share start states, their differences mostly vary less.
    """
    pairs = len(one) * (len(one) - 1) // 2
    level = 1 - (1 - confidence) / (2 * pairs)

    def differences(side: Sequence[tuple[float, float]]) -> list[Interval]:
        found = (rate_difference(*pair, confidence=level) for pair in combinations(side, 2))
        return [each.interval for each in found if each is not None and each.interval is not None]

    return agreement_bounds(differences(one), differences(other), len(one))


def _sign(interval: Interval) -> int:
    """1 or -1 for an interval above or below 0, else 0."""
    return (interval.low > 0) - (interval.high < 0)
