"""Adjustment of p-values for multiple tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

ALPHA = 0.05
"""Default share of true null hypotheses that a test may reject."""


def holm(p_values: Sequence[float]) -> tuple[float, ...]:
    """Adjust p-values such that any of those up to alpha is a false rejection with a probability of at most alpha.

    S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Statist. 6 (1979) 65-70. Valid under
    any dependence.

    Raises:
        ValueError: A p-value outside [0, 1].
    """
    values = _checked(p_values)
    order = np.argsort(values, kind="stable")
    factors = np.arange(len(values), 0, -1)
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * values[order]), 1.0)
    return tuple(adjusted.tolist())


def benjamini_hochberg(p_values: Sequence[float]) -> tuple[float, ...]:
    """Adjust p-values such that at most a share alpha of those up to alpha is expected to be false rejections.

    Y. Benjamini and Y. Hochberg, "Controlling the false discovery rate", J. R. Statist. Soc. B 57 (1995) 289-300. Valid
    for independent or positively dependent tests.

    Raises:
        ValueError: A p-value outside [0, 1].
    """
    from scipy.stats import false_discovery_control

    values = _checked(p_values)
    return tuple(false_discovery_control(values).tolist()) if len(values) else ()


def _checked(p_values: Sequence[float]) -> NDArray[np.float64]:
    values = np.asarray(p_values, dtype=float)
    if not np.all((values >= 0) & (values <= 1)):
        raise ValueError(f"expected p-values in [0, 1], got {list(p_values)}")
    return values
