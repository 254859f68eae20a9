"""Agreement of two simulators on an order, and the cost of a wrong order."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


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
