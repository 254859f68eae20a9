"""How often intervals contain the truth and tests reject a true null hypothesis, by simulation.

10,000 experiments each, 2,000 for bootstrap intervals. This measures not speed but whether the numbers of a report can
be trusted.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.analysis.condition_comparison import interaction
from robogauntlet.results.statistics.aggregate import mean_of_levels
from robogauntlet.results.statistics.pairs import Pairs, mcnemar, paired_difference
from robogauntlet.results.statistics.rates import Interval, wilson_interval
from robogauntlet.results.statistics.sequential import log_evidence
from robogauntlet.results.statistics.severity import falling_trend, severity_curve
from studies.shared import table_of

EXPERIMENTS = 10_000
SIZES = (25, 100, 400)
RATES = tuple(round(0.05 * step, 2) for step in range(1, 20))
BOOTSTRAPS = 2_000
"""Experiments per bootstrap interval."""
DRAWS = 400
"""Draws of a bootstrap; reports use 2,000."""
SEED = 20261121
ALPHA = 0.05


def measure() -> list[dict[str, object]]:
    """Mean coverage over all cells of each interval and size, with the worst cell; error rates of each test."""
    rows: list[dict[str, object]] = []
    for name, simulate in (
        ("Wilson, 95 %", lambda n: _of_counts(n, wilson_interval)),
        ("Newcombe, paired, 95 %", _newcombe),
        ("area kept, bootstrap, 95 %", _area),
        ("lost beyond clean, bootstrap, 95 %", _interaction),
        ("lost over all levels, 90 %", _equivalence),
    ):
        found = {n: simulate(n) for n in SIZES}
        n, cell = min(((n, cell) for n, cells in found.items() for cell in cells), key=lambda at: found[at[0]][at[1]])
        means = {f"n{n}": float(np.mean(list(cells.values()))) for n, cells in found.items()}
        worst = {"worst": found[n][cell], "at": cell, "worst_n": n, "cells": len(found[n])}
        rows.append({"name": name, **means, **worst, "text": f"{100 * found[n][cell]:.1f} % ({cell}; n = {n})"})
        print(rows[-1], flush=True)
    rows += [
        {"name": name, **{f"n{n}": test(n) for n in SIZES}, "text": ""}
        for name, test in (
            ("McNemar, exact, rejects", _mcnemar),
            ("falling trend, rejects", _trend),
            ("e-process, evaluated after every pair, rejects", _evidence),
        )
    ]
    shares = {f"n = {n}": f"{{n{n}:.1%}}" for n in SIZES}
    table_of(rows, {"interval, or test at 5 %": "{name}", **shares, "worst of an interval": "{text}"})
    return rows


def _of_counts(n: int, interval: Callable[[int, int], Interval | None]) -> dict[str, float]:
    found = [interval(count, n) for count in range(n + 1)]
    low, high = (np.array([getattr(ends, side) for ends in found if ends]) for side in ("low", "high"))
    generator = np.random.default_rng([SEED, n])
    cells = {}
    for rate in RATES:
        drawn = generator.binomial(n, rate, EXPERIMENTS)
        cells[f"p {rate}"] = float(((low[drawn] <= rate) & (rate <= high[drawn])).mean())
    return cells


def _joint(first: float, second: float, phi: float) -> NDArray[np.float64] | None:
    """Probabilities of both, first only, second only, neither; None if this correlation is impossible."""
    both = first * second + phi * math.sqrt(first * (1 - first) * second * (1 - second))
    cells = np.array([both, first - both, second - both, 1 - first - second + both])
    return cells if (cells >= -1e-12).all() else None


def _newcombe(n: int) -> dict[str, float]:
    generator = np.random.default_rng([SEED, n, 1])
    cells = {}

    @cache
    def ends(counts: tuple[int, ...]) -> Interval:
        found = paired_difference(Pairs(*counts))
        assert found is not None
        assert found.interval is not None
        return found.interval

    for first in RATES[1::3]:
        for loss in (0.0, 0.1):
            for phi in (0.0, 0.4):
                probabilities = _joint(first, first - loss, phi) if first > loss else None
                if probabilities is None:
                    continue
                drawn = generator.multinomial(n, probabilities.clip(0), EXPERIMENTS)
                found = [ends(tuple(counts)) for counts in drawn.tolist()]
                inside = [interval.low <= loss <= interval.high for interval in found]
                cells[f"p {first}, {round(first - loss, 2)}, phi {phi}"] = float(np.mean(inside))
    return cells


def _outcomes(generator: np.random.Generator, n: int, rates: list[float]) -> list[NDArray[np.float64]]:
    """Outcomes of two tasks with half of the seeds each. Half of the seeds have one random number for all levels."""
    found = []
    for size in (n - n // 2, n // 2):
        luck = np.where(
            generator.random((size, 1)) < 0.5, generator.random((size, 1)), generator.random((size, len(rates)))
        )
        found.append((luck < rates).astype(float))
    return found


def _area(n: int) -> dict[str, float]:
    generator = np.random.default_rng([SEED, n, 2])
    levels = [0.0, 2.0, 4.0]
    cells = {}
    for rates in ([0.9, 0.7, 0.4], [0.6, 0.6, 0.6], [0.8, 0.4, 0.1]):
        truth = (rates[0] + 2 * rates[1] + rates[2]) / (4 * rates[0])
        inside = []
        for _ in range(BOOTSTRAPS):
            area = severity_curve(_outcomes(generator, n, rates), levels, generator, draws=DRAWS).area
            if area is not None and area.interval is not None:
                inside.append(area.interval.low <= truth <= area.interval.high)
        cells[f"p {rates}"] = float(np.mean(inside))
    return cells


def _interaction(n: int) -> dict[str, float]:
    generator = np.random.default_rng([SEED, n, 3])
    cells = {}
    for rates in ([0.9, 0.6, 0.8, 0.2], [0.9, 0.5, 0.9, 0.5], [0.6, 0.3, 0.5, 0.2]):
        truth = rates[1] - rates[3] - rates[0] + rates[2]
        inside = []
        for _ in range(BOOTSTRAPS):
            ends = interaction("", "", 2, _outcomes(generator, n, rates), 1, draws=DRAWS).extra.interval
            if ends is not None:
                inside.append(ends.low <= truth <= ends.high)
        cells[f"p {rates}"] = float(np.mean(inside))
    return cells


def _equivalence(n: int) -> dict[str, float]:
    generator = np.random.default_rng([SEED, n, 6])
    cells = {}
    for rates in ([0.9, 0.6, 0.8, 0.2], [0.9, 0.5, 0.9, 0.5], [0.6, 0.3, 0.5, 0.2]):
        truth = (rates[0] + rates[1] - rates[2] - rates[3]) / 2
        inside = []
        for _ in range(BOOTSTRAPS):
            losses = [np.subtract(*np.hsplit(one, 2)) for one in _outcomes(generator, n, rates)]
            found = mean_of_levels(losses, 1 - 2 * ALPHA)
            if found is not None and (ends := found.interval) is not None:
                inside.append(ends.low <= truth <= ends.high)
        cells[f"p {rates}"] = float(np.mean(inside))
    return cells


def _mcnemar(n: int) -> float:
    probabilities = _joint(0.7, 0.7, 0.3)
    drawn = np.random.default_rng([SEED, n, 5]).multinomial(n, probabilities, EXPERIMENTS)
    p = cache(lambda one, other: mcnemar(Pairs(0, one, other, 0)))
    return float(np.mean([p(one, other) <= ALPHA for _, one, other, _ in drawn.tolist()]))


def _trend(n: int) -> float:
    generator = np.random.default_rng([SEED, n, 6])
    levels = np.array([0.0, 2.0, 4.0])
    found = [falling_trend(_outcomes(generator, n, [0.7] * 3), levels) for _ in range(EXPERIMENTS)]
    return float(np.mean([p is not None and p <= ALPHA for p in found]))


def _evidence(n: int) -> float:
    generator = np.random.default_rng([SEED, n, 7])
    sides = generator.random((EXPERIMENTS, n)) < 0.5
    disagree = generator.random((EXPERIMENTS, n)) < 0.25
    first, second = np.cumsum(sides & disagree, axis=1), np.cumsum(~sides & disagree, axis=1)
    return float((log_evidence(first, second).max(axis=1) >= -math.log(ALPHA)).mean())
