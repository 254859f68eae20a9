"""How often intervals contain the truth and tests reject a true null hypothesis, by simulation.

Each is tried in the designs of published tables and with success near and far from 100 %: this measures not speed but
whether the numbers of a report can be trusted.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.analysis.condition_comparison import equivalence, interaction
from robogauntlet.results.statistics.aggregate import mean_of_levels
from robogauntlet.results.statistics.multiplicity import ALPHA, benjamini_hochberg, holm
from robogauntlet.results.statistics.paired_numbers import median_difference, signed_rank
from robogauntlet.results.statistics.pairs import Pairs, is_no_worse, mcnemar, paired_difference, paired_ratio
from robogauntlet.results.statistics.rank_agreement import kendall
from robogauntlet.results.statistics.rates import (
    Estimate,
    Interval,
    RateBounds,
    rate_bounds,
    rate_difference,
    wilson_interval,
)
from robogauntlet.results.statistics.sequential import log_evidence
from robogauntlet.results.statistics.severity import falling_trend, severity_curve
from studies.percent import few
from studies.shared import table_of

DESIGNS = {"6 x 4": (6, 4), "9 x 10": (9, 10), "9 x 20": (9, 20), "9 x 100": (9, 100)}
"""Tasks and seeds."""
COUNTED, LINEAR, FAMILIES, CURVES = map(few, (2000, 400, 200, 100))
"""Experiments per case: of intervals from counts, from the spread of seeds, of 18 axes together, of whole curves."""
AXES, POLICIES = 18, 6
MARGIN = 0.05
SEED = 20261130
Array = NDArray[np.float64]
Case = Iterator[tuple[str, Iterable[bool | None]]]
"""A case and, experiment by experiment, whether the interval has the truth or the test rejects; None without one."""
RATES = {
    "50 %": (0.5,),
    "90 %": (0.9,),
    "98 %": (0.98,),
    "98 %, one task lost": (0.0, *[0.98] * 8),
    "tasks from 50 to 98 %": (0.5, 0.98, 0.56, 0.92, 0.62, 0.86, 0.68, 0.8, 0.74),
}


def rates(case: str, tasks: int) -> Array:
    """Success in each task."""
    return np.resize(np.array(RATES[case]), tasks)


def played(generator: np.random.Generator, chances: Array, seeds: int, share: float = 0.5) -> Array:
    """Outcomes, shape (tasks, seeds, arms), from success by task and arm; this share of seeds has one luck for all."""
    tasks, arms = chances.shape
    common = generator.random((tasks, seeds, 1)) < share
    luck = np.where(common, generator.random((tasks, seeds, 1)), generator.random((tasks, seeds, arms)))
    return (luck < chances[:, None]).astype(float)


def sides(tasks: int) -> Iterator[tuple[str, Array]]:
    """Success of two policies by task, shape (tasks, 2): equal, and the first worse."""
    for case in RATES:
        own = rates(case, tasks)
        yield f"{case}, equal", np.stack([own, own], axis=1)
        yield f"{case}, and 10 % less", np.stack([own * 0.9, own], axis=1)
    near, lost = rates("98 %", tasks), rates("98 %, one task lost", tasks)
    yield "98 %, and 2 % less", np.stack([near * 0.98, near], axis=1)
    yield "98 %, and one task lost", np.stack([lost, near], axis=1)


def has(ends: Interval | None, truth: float) -> bool | None:
    """Whether an interval has a number."""
    return None if ends is None else ends.low - 1e-12 <= truth <= ends.high + 1e-12


def interval_of(found: Estimate | RateBounds | None) -> Interval | None:
    """The interval of an estimate, if there are both."""
    return None if found is None else found.interval


def _wilson(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    for case in RATES:
        own = rates(case, tasks)
        drawn = generator.binomial(seeds, own, (COUNTED, tasks)).sum(axis=1)
        yield case, [has(wilson_interval(int(k), tasks * seeds), own.mean()) for k in drawn]


def _unequal(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """Every other task lost half of its seeds to errors or the oracle gate."""
    for case in RATES:
        own, found = rates(case, tasks), []
        for _ in range(LINEAR):
            outcomes = played(generator, own[:, None].repeat(2, axis=1), seeds)
            strata = [one[: seeds // 2 if task % 2 else seeds] for task, one in enumerate(outcomes)]
            found.append(has(severity_curve(strata, [0, 1]).rates[1].interval, own.mean()))
        yield case, found


def _bounds(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """Failures are errors in one of four cases."""
    for case in RATES:
        own, found = rates(case, tasks), []
        for wins in generator.binomial(seeds, own, (COUNTED, tasks)).sum(axis=1).tolist():
            errors = int(generator.binomial(tasks * seeds - wins, 0.25))
            limits = rate_bounds(wins, tasks * seeds - wins - errors, errors)
            found.append(has(interval_of(limits), own.mean()))
        yield case, found


def pairs_of(chances: Array, seeds: int, generator: np.random.Generator) -> Iterator[Pairs]:
    """Pairs of all tasks, from success of two policies by task."""
    for _ in range(COUNTED):
        yield Pairs.from_outcomes(*played(generator, chances, seeds).reshape(-1, 2).T)


def _newcombe(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    ends = cache(lambda pairs: interval_of(paired_difference(pairs)))
    for case, chances in sides(tasks):
        truth = float(np.subtract(*chances.T).mean())
        yield case, [has(ends(pairs), truth) for pairs in pairs_of(chances, seeds, generator)]


def _ratio(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    ends = cache(lambda pairs: interval_of(paired_ratio(pairs)))
    for case, chances in sides(tasks):
        truth = float(np.divide(*chances.mean(axis=0)))
        yield case, [has(ends(pairs), truth) for pairs in pairs_of(chances, seeds, generator)]


def _half_of_clean(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """What a search for worst cases confirms with."""
    for case in RATES:
        own, n = rates(case, tasks), tasks * seeds
        wins = generator.binomial(seeds, [own * 0.5, own], (COUNTED, 2, tasks)).sum(axis=2).tolist()
        found = (rate_difference((low, n), (clean, n), 0.5) for low, clean in wins)
        yield case, [has(interval_of(one), 0.0) for one in found]


def _no_worse(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """The first is worse by just the margin."""
    shown = cache(is_no_worse)
    for case in ("50 %", "90 %", "98 %"):
        own = rates(case, tasks)
        pairs = pairs_of(np.stack([own - MARGIN, own], axis=1), seeds, generator)
        yield case, [shown(one, MARGIN) for one in pairs]


@cache
def p_value(first_only: int, second_only: int) -> float:
    """McNemar's, which the other pairs do not change."""
    return mcnemar(Pairs(0, first_only, second_only, 0))


def p_values(first: Array, second: Array) -> list[float]:
    """One per column of outcomes, shape (tasks, seeds, comparisons)."""
    only = ((one > other).sum(axis=(0, 1)).tolist() for one, other in ((first, second), (second, first)))
    return list(map(p_value, *only))


def _mcnemar(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    for case in RATES:
        own, found = rates(case, tasks)[:, None].repeat(2, axis=1), []
        for _ in range(COUNTED):
            one, other = np.split(played(generator, own, seeds), 2, axis=2)
            found.append(p_values(one, other)[0] <= ALPHA)
        yield case, found


def _of_policies(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """All pairs of equal policies, as letters show them."""
    one, other = np.triu_indices(POLICIES, 1)
    for case in RATES:
        own = rates(case, tasks)[:, None].repeat(POLICIES, axis=1)
        drawn = (played(generator, own, seeds) for _ in range(LINEAR))
        yield case, [min(holm(p_values(won[..., one], won[..., other]))) <= ALPHA for won in drawn]


def _of_levels(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """Two equal policies at two levels of each of 18 axes."""
    for case in RATES:
        own = rates(case, tasks)[:, None].repeat(4 * AXES, axis=1)
        drawn = (np.split(played(generator, own, seeds), 2, axis=2) for _ in range(LINEAR))
        yield case, [min(benjamini_hochberg(p_values(*both))) <= ALPHA for both in drawn]


def _trend(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    for case in RATES:
        own = rates(case, tasks)[:, None].repeat(3, axis=1)
        found = (falling_trend([*played(generator, own, seeds)], np.array([0.0, 2, 4])) for _ in range(LINEAR))
        yield case, [p is not None and p <= ALPHA for p in found]


def _evidence(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """Looked at after every pair."""
    for case in RATES:
        own, size = rates(case, tasks)[:, None].repeat(2, axis=1), tasks * seeds
        both = np.stack([played(generator, own, seeds).reshape(size, 2) for _ in range(LINEAR)])
        first, second = (np.cumsum(both[..., i] > both[..., 1 - i], axis=1) for i in (0, 1))
        yield case, (log_evidence(first, second).max(axis=1) >= -math.log(ALPHA)).tolist()


def _orders(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """Two simulators whose orders of 18 axes are independent."""
    found = (kendall(*generator.random((2, AXES))) for _ in range(LINEAR))
    yield "18 axes", [one is not None and one[1] <= ALPHA for one in found]


def perturbed(tasks: int) -> Iterator[tuple[str, Array]]:
    """Success clean and at severity 2 and 4, by task."""
    for case in RATES:
        own = rates(case, tasks)
        yield f"{case}, flat", own[:, None].repeat(3, axis=1)
        yield f"{case}, falling", own[:, None] * [1.0, 0.9, 0.5]
    near, lost = rates("98 %", tasks), rates("98 %, one task lost", tasks)
    yield "98 %, one task lost under perturbation", np.stack([near, lost * 0.9, lost * 0.8], axis=1)


def _area(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    for case, chances in perturbed(tasks):
        truth, found = float((chances @ [0.25, 0.5, 0.25]).sum() / chances[:, 0].sum()), []
        for _ in range(CURVES):
            area = severity_curve(list(played(generator, chances, seeds)), [0, 2, 4]).area
            found.append(has(interval_of(area), truth))
        yield case, found


def two_policies(tasks: int) -> Iterator[tuple[str, Array]]:
    """Success of two policies, clean and at two levels, by task, shape (tasks, 6): the same loss at every level."""
    for case in ("50 %", "90 %", "98 %"):
        own = rates(case, tasks)[:, None]
        yield f"{case}, equal", own * [1, 0.9, 0.5, 1, 0.9, 0.5]
        yield f"{case}, 5 points lost", np.maximum(own * [1, 0.9, 0.7, 1, 0.9, 0.7] - [0, 0, 0, 0.05, 0.05, 0.05], 0)
    near, lost = rates("98 %", tasks)[:, None], rates("98 %, one task lost", tasks)[:, None]
    yield "98 %, one task lost under perturbation", np.hstack([near, lost, lost, near, lost, lost])
    yield "98 %, one task lost by the other policy", np.hstack([near, near, near, lost, lost, lost])


def _all_levels(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    for case, chances in two_policies(tasks):
        truth, found = float((chances[:, 1:3] - chances[:, 4:]).mean()), []
        for _ in range(LINEAR):
            outcomes = played(generator, chances[:, [1, 2, 4, 5]], seeds)
            one = equivalence("", list(outcomes), MARGIN)
            found.append(has(None if one is None else one.loss.interval, truth))
        yield case, found


def _equivalent(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """The second is worse by just the margin."""
    for case, chances in two_policies(tasks):
        if case.endswith("5 points lost"):
            drawn = (played(generator, chances[:, [1, 2, 4, 5]], seeds) for _ in range(LINEAR))
            found = (equivalence("", list(outcomes), MARGIN) for outcomes in drawn)
            yield case, [one is not None and one.is_shown for one in found]


def _beyond_clean(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    for case, chances in two_policies(tasks):
        drawn = (interaction("", "", list(played(generator, chances, seeds)), 1) for _ in range(LINEAR))
        yield case, [has(None if one is None else one.extra.interval, 0.0) for one in drawn]


def _of_axes(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """Shown for any of 18 axes, all played on the same clean episodes."""
    for case, chances in two_policies(tasks):
        one, other = np.hsplit(chances, 2)
        whole = np.hstack([np.hstack([side[:, :1], *[side[:, 1:]] * AXES]) for side in (one, other)])
        found = []
        for _ in range(FAMILIES):
            outcomes = played(generator, whole, seeds)
            loss = np.subtract(*np.split(outcomes, 2, axis=2))
            beyond = loss[..., 1::2] + loss[..., 2::2] - 2 * loss[..., :1]
            # Student's interval of 18 axes is wider than two standard errors: the others are not shown.
            errors = np.sqrt(beyond.var(axis=1, ddof=1).sum(axis=0) / seeds)
            shown = False
            for axis in np.flatnonzero(np.abs(beyond.mean(axis=1).sum(axis=0)) > 2 * errors):
                levels = [0, 1 + 2 * axis, 2 + 2 * axis]
                own = outcomes[..., [*levels, *(level + 1 + 2 * AXES for level in levels)]]
                row = interaction("", "", list(own), AXES)
                shown = shown or (row is not None and row.is_shown)
            found.append(shown)
        yield case, found


def numbers(tasks: int, seeds: int, generator: np.random.Generator) -> Iterator[tuple[str, Array, float]]:
    """Differences of a number, shape (experiments, trials), and their median."""
    shape = (LINEAR, tasks * seeds)
    yield "symmetric", generator.normal(size=shape), 0.0
    yield "skewed", generator.exponential(size=shape), math.log(2)
    yield "counts", generator.poisson(1.2, shape) - generator.poisson(1.2, shape).astype(float), 0.0
    of_task = np.repeat(np.linspace(-1, 1, tasks), seeds)
    yield "tasks differ", of_task + generator.normal(size=shape), 0.0


def _median(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    for case, drawn, truth in numbers(tasks, seeds, generator):
        yield case, [has(median_difference(one).interval, truth) for one in drawn]


def _ranks(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    for case, drawn, _ in numbers(tasks, seeds, generator):
        if case != "skewed":
            yield case, [signed_rank(one) <= ALPHA for one in drawn]


def _mean(tasks: int, seeds: int, generator: np.random.Generator) -> Case:
    """Two levels of each of 18 axes."""
    for case in RATES:
        own, found = rates(case, tasks)[:, None].repeat(2 * AXES, axis=1), []
        for _ in range(CURVES):
            estimate = mean_of_levels(list(played(generator, own, seeds)))
            found.append(has(interval_of(estimate), own.mean()))
        yield case, found


INTERVALS: Mapping[str, tuple[float, Callable[[int, int, np.random.Generator], Case]]] = {
    "success rate (Wilson)": (0.95, _wilson),
    "success rate, tasks of unequal numbers of seeds (Wilson, Kish)": (0.95, _unequal),
    "success rate with errors (bounds)": (0.95, _bounds),
    "difference of two policies (Newcombe)": (0.95, _newcombe),
    "share of success kept (Tang)": (0.95, _ratio),
    "success minus half of the clean one (Zou and Donner)": (0.95, _half_of_clean),
    "area kept (Student)": (0.95, _area),
    "loss over all levels (Student)": (0.9, _all_levels),
    "loss beyond the clean one (Student)": (0.95, _beyond_clean),
    "median difference (sign test)": (0.95, _median),
    "not shown: mean success over all levels (Student)": (0.95, _mean),
}
TESTS: Mapping[str, tuple[float, Callable[[int, int, np.random.Generator], Case]]] = {
    "equal rates (McNemar, exact)": (ALPHA, _mcnemar),
    "any of 15 pairs of policies (Holm)": (ALPHA, _of_policies),
    "any of 36 levels (Benjamini-Hochberg)": (ALPHA, _of_levels),
    "any of 18 axes beyond clean (Student, Bonferroni)": (ALPHA, _of_axes),
    "no worse by 5 points (Newcombe)": (ALPHA / 2, _no_worse),
    "equivalent within 5 points (two one-sided tests)": (ALPHA, _equivalent),
    "falling trend (Cochran and Armitage)": (ALPHA, _trend),
    "e-value, looked at after every pair": (ALPHA, _evidence),
    "order of axes (Kendall)": (ALPHA, _orders),
    "difference of a number (Wilcoxon)": (ALPHA, _ranks),
}


def measure() -> list[dict[str, object]]:
    """Coverage and error rates by design, on average over cases, with the worst case and its Monte Carlo error."""
    rows: list[dict[str, object]] = []
    for kind, family in (("covers", INTERVALS), ("rejects", TESTS)):
        for name, (promised, simulate) in family.items():
            cells: list[tuple[float, int, str]] = []
            row: dict[str, object] = {"name": name, "kind": kind, "promised": promised}
            none = []
            for number, (design, (tasks, seeds)) in enumerate(DESIGNS.items()):
                found = []
                for case, experiments in simulate(tasks, seeds, np.random.default_rng([SEED, number])):
                    tried = list(experiments)
                    right = [one for one in tried if one is not None]
                    none.append(1 - len(right) / len(tried))
                    if len(right) >= len(tried) / 10:
                        found.append(float(np.mean(right)))
                        cells.append((found[-1], len(right), f"{design}: {case}"))
                row[design.replace(" ", "")] = float(np.mean(found))
            share, count, where = (min if kind == "covers" else max)(cells)
            error = math.sqrt(share * (1 - share) / count)
            row |= {"worst": share, "error": error, "case": where, "none": float(np.mean(none))}
            row["worst_text"] = f"{100 * share:.1f} ± {100 * error:.1f} % ({where})"
            rows.append(row)
            print(row, flush=True)
    designs = {design: f"{{{design.replace(' ', '')}:.1%}}" for design in DESIGNS}
    columns = {"interval or test": "{name}", "promised": "{promised:.1%}", **designs}
    table_of(rows, {**columns, "worst": "{worst_text}", "without interval": "{none:.1%}"})
    return rows
