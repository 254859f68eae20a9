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

from robogauntlet.results.statistics.sensitivity import Sensitivity, sobol_indices
from robogauntlet.suites.designs import sobol_rows
from studies.shared import table_of

EXPERIMENTS = 1000
SIZES = ((64, 4), (64, 10), (128, 6), (256, 4), (256, 10))
"""Base points and seeds."""
SEED = 20261125
NODES = 16
"""Of a quadrature, for each axis."""
PARTS = ("first", "total", "interaction")
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


RESPONSES = {
    "Ishigami": Response(3, ishigami),
    "logistic": Response(4, lambda levels: expit(logit(levels))),
    "logistic, seeds shift it": Response(4, logit, seed_spread=1.0),
}


def measure() -> list[dict[str, object]]:
    """Coverage where there are indices: the mean over axes and the lowest; mean widths; share without indices."""
    rows: list[dict[str, object]] = []
    for (name, response), (points, seeds) in product(RESPONSES.items(), SIZES):
        rows.append({"response": name, "points": points, "seeds": seeds, **_row(response, points, seeds)})
        print(f"{name}, {points} points, {seeds} seeds: lowest {rows[-1]['lowest']:.1%}", flush=True)
    shown = {part: "{" + part.replace(" ", "_") + ":.1%}" for part in (*PARTS, "explained")}
    header = {"response": "{response}", "base points": "{points}", "seeds": "{seeds}"}
    table_of(rows, {**header, **shown, "lowest of an axis": "{lowest:.1%} ({at})", "not shown": "{undefined:.1%}"})
    return rows


def _row(response: Response, points: int, seeds: int) -> dict[str, object]:
    true = truth(response)
    generator = np.random.default_rng([SEED, points, seeds])
    names = [str(number) for number in range(response.axes)]
    inside: dict[str, list[bool]] = {key: [] for key in true}
    widths: dict[str, list[float]] = {key: [] for key in true}
    undefined = 0
    for _ in range(EXPERIMENTS):
        found = sobol_indices(response.outcomes(points, seeds, generator), names)
        undefined += found.axes is None
        for key, (low, high) in _intervals(found).items():
            inside[key].append(low <= true[key] <= high)
            widths[key].append(high - low)
    covered = {key: float(np.mean(own)) for key, own in inside.items()}
    lowest = min((key for key in covered if key != "explained"), key=lambda key: covered[key])
    row: dict[str, object] = {"undefined": undefined / EXPERIMENTS, "lowest": covered[lowest], "at": lowest}
    for part in (*PARTS, "explained"):
        own = [key for key in true if key.startswith(part)]
        row[part] = float(np.mean([covered[key] for key in own]))
        row[f"{part} width"] = float(np.mean([np.mean(widths[key]) for key in own]))
    return {**row, "covered": covered, "true": true}


def _intervals(found: Sensitivity) -> dict[str, tuple[float, float]]:
    estimates = {"explained": found.explained}
    for axis in found.axes or ():
        estimates |= {f"{part} {axis.axis}": getattr(axis, part) for part in PARTS}
    ends = {key: estimate.interval for key, estimate in estimates.items() if estimate is not None}
    return {key: (interval.low, interval.high) for key, interval in ends.items() if interval is not None}


def truth(response: Response) -> dict[str, float]:
    """Indices of a response: for Ishigami by its formulae, otherwise by Gauss-Legendre quadrature."""
    if response.logit_or_rate is ishigami:
        wide = 1 + 0.1 * np.pi**4
        single, second, pair = 0.5 * (1 + 0.02 * np.pi**4) ** 2, 49 / 8, 0.08 * np.pi**8 / 225
        own, all_of = [single, second, 0.0], [single + pair, second, pair]
        variance = single + second + pair
        mean, scaled = (3.5 + wide) / (7 + 2 * wide), variance / (7 + 2 * wide) ** 2
        first, total = (np.array(values) / variance for values in (own, all_of))
    else:
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        grid = np.stack(np.meshgrid(*[(nodes + 1) / 2] * response.axes, indexing="ij"), axis=-1)
        rates, weights = response.rate(grid), weights / 2

        def mean_over(values: Array, axes: list[int]) -> Array:
            for axis in sorted(axes, reverse=True):
                values = np.moveaxis(values, axis, -1) @ weights
            return values

        every = list(range(response.axes))
        mean = float(mean_over(rates, every))
        scaled = float(mean_over(rates**2, every)) - mean**2
        others = [[other for other in every if other != axis] for axis in every]
        first = np.array([weights @ (mean_over(rates, rest) - mean) ** 2 for rest in others]) / scaled
        left = [mean_over(rates, [axis]) ** 2 for axis in every]
        total = np.array([1 - (float(mean_over(part, every[:-1])) - mean**2) / scaled for part in left])
    found = {"explained": scaled / (mean * (1 - mean))}
    for axis, (one, whole) in enumerate(zip(first.tolist(), total.tolist(), strict=True)):
        found |= {f"first {axis}": one, f"total {axis}": whole, f"interaction {axis}": whole - one}
    return found
