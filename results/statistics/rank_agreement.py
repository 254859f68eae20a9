"""Do two simulators agree, and on what: order of axes or policies, and what a wrong order costs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


def kendall(one: Sequence[float], other: Sequence[float]) -> tuple[float, float] | None:
    """Agreement in order of the same things scored twice, from -1 to 1, and its one-sided p-value.

    Tau-b of M. G. Kendall, Biometrika 33 (1945) 239-251, which corrects for ties. The p-value is against orders that
    have nothing to do with each other, the things being a sample of many: of the permutations of the order where there
    are no ties, else of the normal approximation (scipy).

    Returns:
        None with fewer than two things, or where one side ties all of them.

    Raises:
        ValueError: Unlike numbers of scores.
    """
    from scipy.stats import kendalltau

    _check(one, other)
    if len(one) < 2:
        return None
    found = kendalltau(one, other, alternative="greater")
    return None if math.isnan(found.statistic) else (float(found.statistic), float(found.pvalue))


def rank_violation(one: Sequence[float], other: Sequence[float]) -> float | None:
    """Mean maximum rank violation (MMRV): what the worst disagreement in order costs each thing, on average.

    mean_i max_j |one_i - one_j| 1[(other_i < other_j) != (one_i < one_j)], X. Li et al., "Evaluating real-world robot
    manipulation policies in simulation" (arXiv 2405.05941) equation 1; the first side is the one that counts. 0 is
    perfect agreement.

    Returns:
        None with fewer than two things.

    Raises:
        ValueError: Unlike numbers of scores.
    """
    _check(one, other)
    if len(one) < 2:
        return None
    a, b = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    violated = (a[:, None] < a) != (b[:, None] < b)
    return float(np.max(np.abs(a[:, None] - a) * violated, axis=1).mean())


def _check(one: Sequence[float], other: Sequence[float]) -> None:
    if len(one) != len(other):
        raise ValueError(f"expected a score of each thing on both sides, got {len(one)} and {len(other)}")
