"""Many tests at once: which of them stand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

ALPHA = 0.05
"""Share of true null hypotheses that a test may reject, unless another is asked for."""


def holm(p_values: Sequence[float]) -> tuple[float, ...]:
    """p-values adjusted so that rejecting those of at most alpha errs at all with a probability of at most alpha.

    S. Holm, "A simple sequentially rejective multiple test procedure", Scand. J. Statist. 6 (1979) 65-70. Valid under
    any dependence. Not statsmodels' own, which collects garbage at every call: a tenth of a second each, by hand.

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
    """p-values adjusted so that of those of at most alpha a share of at most alpha is expected to be false.

    Y. Benjamini and Y. Hochberg, "Controlling the false discovery rate", J. R. Statist. Soc. B 57 (1995) 289-300. Valid
    for independent tests and for those that depend positively.

    Raises:
        ValueError: A p-value outside [0, 1].
    """
    from scipy.stats import false_discovery_control

    values = _checked(p_values)
    return tuple(false_discovery_control(values).tolist()) if len(values) else ()


def e_benjamini_hochberg(e_values: Sequence[float], alpha: float = ALPHA) -> tuple[bool, ...]:
    """Which hypotheses are rejected so that a share of at most alpha of them is expected to be false.

    With e_[k] the k-th greatest of K, those of at least K / (alpha k*) are, k* the greatest k with k e_[k] / K >=
    1 / alpha: R. Wang and A. Ramdas, "False discovery rate control with e-values", J. R. Statist. Soc. B 84 (2022)
    822-852. Valid under any dependence and any stopping rule.

    Raises:
        ValueError: An e-value below 0, or alpha outside (0, 1].
    """
    if any(not value >= 0 for value in e_values) or not 0 < alpha <= 1:
        raise ValueError(f"expected e-values of 0 or more and an alpha in (0, 1], got {list(e_values)} and {alpha}")
    count = len(e_values)
    ranked = sorted(e_values, reverse=True)
    most = max((k for k, value in enumerate(ranked, start=1) if k * value * alpha >= count), default=0)
    return tuple(bool(most) and value * alpha * most >= count for value in e_values)


def _checked(p_values: Sequence[float]) -> NDArray[np.float64]:
    values = np.asarray(p_values, dtype=float)
    if not np.all((values >= 0) & (values <= 1)):
        raise ValueError(f"expected p-values in [0, 1], got {list(p_values)}")
    return values
