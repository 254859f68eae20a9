"""How often the intervals of Sobol' indices contain the truth, by 1,000 simulated experiments per response and size.

Responses give the success rate at levels in [0, 1]; each rollout is one draw with that rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.results.statistics.sensitivity import sobol_indices
from robogauntlet.suites.designs import sobol_rows
from studies.percent import few
from studies.shared import table_of

EXPERIMENTS = few(1000)
SIZES = ((64, 4), (64, 10), (128, 6), (256, 4))
"""Base points and seeds; the first are those of the suite `why`."""
SEED = 20261125
NODES = 16
"""Of a quadrature, for each axis."""
LEAST = 1e-6
"""Smaller indices are 0."""
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Response:
    """A policy whose indices are known."""

    axes: int
    logit_or_rate: Callable[[Array], Array]
    """Levels, shape (..., axes), to a rate, or to its logit where seeds shift it."""
    seed_spread: float | None = None
    """Standard deviation of the shifts of seeds on the scale of the logit; None where the function gives the rate."""

    def rate(self, levels: Array) -> Array:
        """Mean success over seeds."""
        found = self.logit_or_rate(levels)
        if self.seed_spread is None:
            return found
        nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
        shifted: Array = expit(found[..., None] + self.seed_spread * nodes) @ (weights / weights.sum())
        return shifted

    def outcomes(self, points: int, seeds: int, generator: np.random.Generator) -> Array:
        """Outcomes of one experiment."""
        levels = sobol_rows(self.axes, points, generator).reshape(points, self.axes + 2, self.axes)
        found = self.logit_or_rate(levels)[..., None]
        rates = found if self.seed_spread is None else expit(found + self.seed_spread * generator.normal(size=seeds))
        return (generator.random((*found.shape[:2], seeds)) < rates).astype(float)


def ishigami(levels: Array) -> Array:
    """The function of T. Ishigami and T. Homma (1990), a = 7 and b = 0.1, scaled to [0, 1]."""
    x, y, z = np.moveaxis(np.pi * (2 * levels - 1), -1, 0)
    found: Array = np.sin(x) * (1 + 0.1 * z**4) + 7 * np.sin(y) ** 2
    lowest, highest = -(1 + 0.1 * np.pi**4), 8 + 0.1 * np.pi**4
    return (found - lowest) / (highest - lowest)


def logit(levels: Array) -> Array:
    """Two axes with an effect of their own, two that only matter together with each other."""
    first, second, third, fourth = np.moveaxis(levels, -1, 0)
    found: Array = 2 - 3 * first - 4 * second * third - fourth
    return found


def broken(levels: Array, least: int, of: int) -> Array:
    """Success breaks down where at least so many of the first axes are beyond half of their range."""
    found: Array = np.where((levels[..., :of] > 0.5).sum(axis=-1) >= least, 0.1, 0.95)
    return found


RESPONSES = {
    "breaks at half of either of two axes, of five": Response(5, lambda levels: broken(levels, 1, 2)),
    "breaks at half of both of two axes, of five": Response(5, lambda levels: broken(levels, 2, 2)),
    "breaks at half of two of three axes, of five": Response(5, lambda levels: broken(levels, 2, 3)),
    "Ishigami": Response(3, ishigami),
    "logistic": Response(4, lambda levels: expit(logit(levels))),
    "logistic, seeds shift it": Response(4, logit, seed_spread=1.0),
}


def measure() -> list[dict[str, object]]:
    """Coverage where there are indices: the mean over axes and the lowest; share of designs without indices."""
    rows: list[dict[str, object]] = []
    for (name, response), (points, seeds) in product(RESPONSES.items(), SIZES):
        rows.append({"response": name, "points": points, "seeds": seeds, **_row(response, points, seeds)})
        print(f"{name}, {points} points, {seeds} seeds: lowest {rows[-1]['lowest']}", flush=True)
    shown = {"total": "{total}", "lowest of an axis": "{lowest}", "axes without effect": "{null}"}
    shown |= {"one of these shown": "{null_shown}", "explained": "{explained}", "no index": "{undefined:.1%}"}
    table_of(rows, {"response": "{response}", "base points": "{points}", "seeds": "{seeds}", **shown})
    return rows


def _row(response: Response, points: int, seeds: int) -> dict[str, object]:
    totals, explained = truth(response)
    generator = np.random.default_rng([SEED, points, seeds])
    inside, positive, of_explained = [], [], []
    for _ in range(EXPERIMENTS):
        found = sobol_indices(response.outcomes(points, seeds, generator), list(map(str, range(response.axes))))
        if found.explained is not None and found.explained.interval is not None:
            of_explained.append(_contains(found.explained, explained))
        if found.axes is not None:
            estimates = [axis.total for axis in found.axes]
            inside.append([_contains(one, true) for one, true in zip(estimates, totals, strict=True)])
            positive.append([one.interval is not None and one.interval.low > 0 for one in estimates])
    null = np.array(totals) < LEAST
    covered = np.mean(inside, axis=0)
    return {
        "total": f"{covered.mean():.1%}",
        "lowest": f"{covered.min():.1%}",
        "null": f"{covered[null].mean():.1%}" if null.any() else "",
        "null_shown": f"{np.array(positive)[:, null].any(axis=1).mean():.1%}" if null.any() else "",
        "explained": f"{np.mean(of_explained):.1%}" if of_explained else "",
        "undefined": 1 - len(inside) / EXPERIMENTS,
    }


def _contains(estimate: Estimate, true: float) -> bool:
    """Whether the interval has the true share; one without an interval shows no spread, and is 0."""
    if estimate.interval is None:
        return abs(estimate.value - true) < LEAST
    return estimate.interval.low - LEAST <= true <= estimate.interval.high + LEAST


def truth(response: Response) -> tuple[list[float], float]:
    """Total indices, and Var f / Var y: for Ishigami by its formulae, otherwise by Gauss-Legendre quadrature."""
    if response.logit_or_rate is ishigami:
        wide = 1 + 0.1 * np.pi**4
        single, second, pair = 0.5 * (1 + 0.02 * np.pi**4) ** 2, 49 / 8, 0.08 * np.pi**8 / 225
        variance = single + second + pair
        mean, scaled = (3.5 + wide) / (7 + 2 * wide), variance / (7 + 2 * wide) ** 2
        totals = np.array([single + pair, second, pair]) / variance
    else:
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        rates = response.rate(np.stack(np.meshgrid(*[(nodes + 1) / 2] * response.axes, indexing="ij"), axis=-1))

        def mean_over(values: Array, axes: range) -> Array:
            for _ in axes:
                values = values @ (weights / 2)
            return values

        every = range(response.axes)
        mean = float(mean_over(rates, every))
        scaled = float(mean_over(rates**2, every)) - mean**2
        left = [np.moveaxis(rates, axis, -1) @ (weights / 2) for axis in every]
        totals = np.array([1 - (float(mean_over(part**2, every[1:])) - mean**2) / scaled for part in left])
    return totals.tolist(), scaled / (mean * (1 - mean))
