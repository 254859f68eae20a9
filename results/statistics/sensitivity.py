"""Sobol' total indices: the share of a policy's variance in success in which each axis takes part.

An outcome y(x, s) depends on the levels x of the axes and on a seed s. The indices are those of f(x), the success rate
at x, which is the mean of y over seeds:

    total_i = E Var[f | all but x_i] / Var f

(I. M. Sobol', Mathematics and Computers in Simulation 55 (2001) 271-280; T. Homma and A. Saltelli, Reliability
Engineering & System Safety 52 (1996) 1-17). A rollout shows y, not f. With y in place of f, the variance of a rollout
about its rate counts as variance of f and as an interaction of all axes. Here each second moment is a mean of products
of outcomes at two different seeds (a U-statistic over seeds: W. Hoeffding, Ann. Math. Statist. 19 (1948) 293-325). It
has no such bias, also where seeds have effects of their own.

First-order indices, of what an axis causes by itself, are not given. They compare two base points, A and B, and Sobol'
points are so regular that the two depend on each other: where success breaks down at half of the range, intervals at 64
base points missed the truth of axes without any effect far too often. A total index compares rows of one base point.

Neither SALib nor `scipy.stats.sobol_indices` is used. They take one output per point as the exact f and divide by the
variance of outputs, noise included: total indices are too large, and intervals have no spread of seeds. With averages
over seeds as outputs this bias is less, not none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robogauntlet.results.statistics.rates import CONFIDENCE, Estimate, Interval

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

STEPS = 500
"""Values between 0 and 1 that are tested for an interval, less one."""
VARIANCE, NOISE = 0, 1
"""Places of Var f and of the mean variance at a point among the moments; those of the axes follow."""
LEAST_SEEDS = 10
"""Seeds from which `explained` has an interval: with fewer, which shift success much, it is too short."""


@dataclass(frozen=True, slots=True)
class AxisSensitivity:
    """Sobol' index of one axis."""

    axis: str
    total: Estimate
    """Share of Var f that the axis causes by itself and in interactions, clipped to [0, 1]."""


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Sobol' indices of all axes of a design."""

    axes: tuple[AxisSensitivity, ...] | None
    """In the order given; None where Var f is not shown to be positive, so that there is nothing to share."""
    explained: Estimate | None
    """Var f / Var y: share of the variance of a rollout that the axes cause; None if Var y is not positive."""


def sobol_indices(outcomes: NDArray[np.floating], axes: Sequence[str]) -> Sensitivity:
    """Sobol' indices of noisy outcomes, with intervals (95 %) for the spread of base points and of seeds.

    With K the covariance of two rows over base points, each product at two different seeds:

        Var f = mean of K(r, r) over all rows r
        total_i Var f = (K(A, A) + K(A_B^(i), A_B^(i))) / 2 - K(A, A_B^(i))

    the second as M. J. W. Jansen, Computer Physics Communications 117 (1999) 35-43. An index is a ratio of two moments.
    Its interval has the values r for which numerator - r denominator does not differ from 0 by a t test (E. C. Fieller,
    J. R. Statist. Soc. B 16 (1954) 175-185), which stays valid where Var f is barely known. The variance of that
    difference is the sum of two:

    - that of its mean over base points with the seeds fixed, which includes the noise of rollouts. It takes base points
      as independent; of these moments Sobol' points vary less, so that intervals are rather too wide;
    - that of the jackknife over seeds (J. N. Arvesen, Ann. Math. Statist. 40 (1969) 2076-2100) less what the noise of
      rollouts adds to it, or 0 if that is more.

    Degrees of freedom as F. E. Satterthwaite, Biometrics Bulletin 2 (1946) 110-114. `studies/intervals` measures how
    often intervals contain the truth.

    Args:
        outcomes: Shape (base points, axes + 2, seeds), in [0, 1], a success 1 and a failure 0. Rows of a base point as
            `suites.designs.sobol_rows` orders them; the same seeds, in the same order, at all points.
        axes: Their names.

    Returns:
        The indices. With two seeds they have no interval, as the spread of seeds cannot be seen; Var f is then compared
        with the spread of base points alone. An index whose parts are all alike has none either: they show no spread;
        nor has `explained` with fewer than `LEAST_SEEDS` seeds.

    Raises:
        ValueError: Another shape, fewer than two base points or seeds, or outcomes outside [0, 1] or missing.
    """
    import numpy as np

    values = _checked(outcomes, len(axes))
    if (values == values.flat[0]).all():
        return Sensitivity(None, None)
    moments = _Moments.of(_contributions(values))
    unit = np.eye(2 + len(axes))
    whole = unit[VARIANCE]
    everything = whole + unit[NOISE]
    explained = moments.ratio(whole, everything, LEAST_SEEDS) if everything @ moments.values > 0 else None
    if not moments.is_positive(whole):
        return Sensitivity(None, explained)
    totals = (moments.ratio(total, whole) for total in unit[2:])
    return Sensitivity(tuple(map(AxisSensitivity, axes, totals)), explained)


@dataclass(frozen=True, slots=True)
class _Moments:
    """Estimated moments with what their intervals need; m moments."""

    values: NDArray[np.float64]
    """Shape (m,)."""
    points: NDArray[np.float64]
    """Covariance of the values from base points and noise, shape (m, m)."""
    seeds: NDArray[np.float64]
    """Covariance from seeds, shape (m, m); sampling error may make a variance negative."""
    count: tuple[int, int]
    """Base points and seeds."""

    @classmethod
    def of(cls, parts: NDArray[np.float64]) -> _Moments:
        """Moments that are means of these parts, shape (m, base points, seeds)."""
        import numpy as np

        _, n, k = parts.shape
        by_point, by_seed = parts.mean(axis=2), parts.mean(axis=1)
        values = by_point.mean(axis=1)
        seeds = np.zeros((len(values), len(values)))
        if k > 2:
            deviations = by_seed - values[:, None]
            # What remains of a cell without its point and its seed is noise of a rollout.
            cells = (parts - by_point[:, :, None] - deviations[:, None, :]).reshape(len(values), -1)
            factor = 4 * (k - 1) / (k * (k - 2) ** 2)
            seeds = factor * (deviations @ deviations.T - cells @ cells.T / (n * (n - 1)))
        return cls(values, np.cov(by_point) / n, seeds, (n, k))

    def spread(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far sums of the moments, weights of shape (sums, m), may lie from their expectation, shape (sums,)."""
        import numpy as np
        from scipy.special import stdtrit

        n, k = self.count
        points = ((weights @ self.points) * weights).sum(axis=1).clip(0)
        seeds = ((weights @ self.seeds) * weights).sum(axis=1).clip(0)
        variance = points + seeds
        with np.errstate(invalid="ignore", divide="ignore"):
            freedom = variance**2 / (points**2 / (n - 1) + seeds**2 / (k - 1))
        quantiles = stdtrit(np.where(variance > 0, freedom, 1.0), (1 + CONFIDENCE) / 2)
        found: NDArray[np.float64] = quantiles * np.sqrt(variance)
        return found

    def is_positive(self, weights: NDArray[np.float64]) -> bool:
        """Whether a sum of moments is shown to be positive, with an error of at most (1 - confidence) / 2."""
        return bool(weights @ self.values > self.spread(weights[None])[0])

    def ratio(self, top: NDArray[np.float64], bottom: NDArray[np.float64], least_seeds: int = 3) -> Estimate:
        """A ratio of two sums of moments, known to lie in [0, 1]; no interval where the upper sum shows no spread."""
        import numpy as np

        value = float(np.clip((top @ self.values) / (bottom @ self.values), 0, 1))
        if self.count[1] < least_seeds or self.spread(top[None])[0] == 0:
            return Estimate(value, None)
        tested = np.linspace(0, 1, STEPS + 1)
        weights = top - tested[:, None] * bottom
        excess, spread = np.abs(weights @ self.values), self.spread(weights)
        inside = tested[excess <= spread]
        # A step on either side may still belong to it. If none fits, the value itself is at an end, 0 or 1.
        low, high = (inside[0] - 1 / STEPS, inside[-1] + 1 / STEPS) if len(inside) else (value, value)
        return Estimate(value, Interval(min(max(float(low), 0.0), value), max(min(float(high), 1.0), value)))


def _contributions(outcomes: NDArray[np.float64]) -> NDArray[np.float64]:
    """What each base point and seed adds to each moment, shape (2 + axes, base points, seeds).

    Their mean over base points and seeds is the moment. That of a seed is its mean with all other seeds.
    """
    import numpy as np

    n, _, k = outcomes.shape
    # Centred by row and seed with divisor n - 1, means of products are covariances without bias.
    centred = (outcomes - outcomes.mean(axis=0)) * np.sqrt(n / (n - 1))
    step = centred[:, 1:-1] - centred[:, :1]
    rest = outcomes.sum(axis=2, keepdims=True) - outcomes
    rest_squares = (outcomes**2).sum(axis=2, keepdims=True) - outcomes**2
    noise = (outcomes**2 + (rest_squares - 2 * outcomes * rest) / (k - 1)) / 2
    leading = np.stack([_products(centred).mean(axis=1), noise.mean(axis=1)])
    return np.concatenate([leading, _products(step).swapaxes(0, 1) / 2])


def _products(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean product of a value at a seed with those at the other seeds; seeds on the last axis."""
    rest = values.sum(axis=-1, keepdims=True) - values
    found: NDArray[np.float64] = values * rest / (values.shape[-1] - 1)
    return found


def _checked(outcomes: NDArray[np.floating], axes: int) -> NDArray[np.float64]:
    import numpy as np

    values = np.asarray(outcomes, dtype=float)
    if axes < 1 or values.ndim != 3 or values.shape[1] != axes + 2:
        raise ValueError(f"expected outcomes of shape (base points, {axes + 2}, seeds), got {values.shape}")
    if values.shape[0] < 2 or values.shape[2] < 2:
        raise ValueError(
            f"expected at least two base points and two seeds, got {values.shape[0]} and {values.shape[2]}"
        )
    if not np.all((values >= 0) & (values <= 1)):
        raise ValueError("expected outcomes in [0, 1] and none missing")
    return values
