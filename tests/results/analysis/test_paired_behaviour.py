"""How two sides move and fail on the same episodes."""

from dataclasses import replace

import pytest

from robogauntlet.results.analysis.comparison import Run, compare_runs
from robogauntlet.results.analysis.paired_behaviour import COLUMNS, LEAST_PAIRS, adjusted, compare_behaviour
from robogauntlet.results.analysis.pairwise import (
    COLUMNS as PAIRWISE_COLUMNS,
    PolicyRows,
    compare_all,
    compare_policies,
)
from robogauntlet.results.statistics.rates import Estimate, Interval
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, columns_of, document, row, rows_where, with_behaviour

PLAN = cells(("a", "b"), ("maniskill/A", "pybullet/B"))


def found(plan, results):
    frames = [columns_of([r for r in results if r.policy == name], (*COLUMNS, "pair_id")) for name in ("a", "b")]
    return compare_behaviour(frames[0].merge(frames[1], on="pair_id", suffixes=("", "_before")), 0.05)


def longer_by(shift, seeds=12, plan=PLAN):
    """Both always succeed; the paths of `a` are longer."""
    return [
        row(cell, seed, path_length=0.4 + seed / 100 + (shift + seed / 1e4 if cell.policy == "a" else 0))
        for cell in plan
        for seed in range(seeds)
    ]


def test_rows_of_earlier_versions_are_not_compared():
    measured = with_behaviour(rows_where(lambda cell, seed: True, PLAN, 8))
    before = [replace(one, **dict.fromkeys(COLUMNS[3:])) if one.policy == "b" else one for one in measured]
    assert found(PLAN, before) is None
    assert found(PLAN, []) is None


def test_a_longer_path_is_shown_with_its_median_and_interval():
    (line,) = adjusted([found(PLAN, longer_by(0.05))])[0].measures
    assert (line.measure, line.pairs) == ("path_length", 24)
    assert line.difference.value == pytest.approx(0.05, abs=0.002)
    assert line.difference.interval.low > 0.05
    assert line.p == line.adjusted < 0.001


def test_equal_paths_are_neither_shown_nor_tested():
    results = [replace(one, path_length=0.1 + 0.2 if one.policy == "a" else 0.3) for one in longer_by(0)]
    (line,) = adjusted([found(PLAN, results)])[0].measures
    assert line.difference == Estimate(0.0, Interval(0.0, 0.0))
    assert (line.p, line.is_tested, line.adjusted) == (1.0, False, 1.0)


def test_only_pairs_in_which_both_succeeded_are_measured():
    results = [
        replace(one, status="failure", path_length=9.0) if one.policy == "a" and one.seed < 4 else one
        for one in longer_by(0.05)
    ]
    compared = found(PLAN, results)
    assert compared.pairs == 16
    assert compared.measures[0].difference.value < 0.06


def test_too_few_pairs_are_not_compared():
    few = cells(("a", "b"), ("maniskill/A",))
    compared = found(few, longer_by(0.05, LEAST_PAIRS - 1, few))
    assert (compared.pairs, compared.measures) == (LEAST_PAIRS - 1, ())
    assert found(few, longer_by(0.05, LEAST_PAIRS, few)).measures[0].is_tested


def test_several_conditions_of_a_start_state_count_once():
    conditions = (Condition(), Condition("noise", 2), Condition("noise", 4))
    plan = cells(("a", "b"), ("maniskill/A",), conditions)
    (line,) = found(plan, longer_by(0.05, 8, plan)).measures
    assert line.pairs == 8


def test_p_values_are_adjusted_over_all_measures_and_comparisons():
    results = with_behaviour(rows_where(lambda cell, seed: True, PLAN, 20))
    one = found(PLAN, results)
    tested = [line for line in one.measures if line.is_tested]
    smallest = min(tested, key=lambda line: line.p)
    twice = adjusted([one, None, one])
    shown = next(line for line in twice[2].measures if line.measure == smallest.measure)
    assert twice[1] is None
    assert shown.adjusted == pytest.approx(min(1, 2 * len(tested) * smallest.p))


def test_outcomes_of_pairs_are_counted_unless_both_succeeded():
    kinds = {("a", 0): "dropped", ("b", 0): "misplaced", ("a", 1): "dropped", ("b", 2): "melted"}
    cells_ = cells(("a", "b"), ("maniskill/A",))
    results = [
        row(
            cell, seed, "failure" if (cell.policy, seed) in kinds else "success", failure=kinds.get((cell.policy, seed))
        )
        for cell in cells_
        for seed in range(8)
    ]
    changes = found(cells_, results).changes
    assert {(change.first, change.second): change.pairs for change in changes} == {
        **{("success", "other"): 1, ("dropped", "success"): 1},
        **{("dropped", "misplaced"): 1},
    }


def test_policies_of_a_run_are_compared_by_clean_and_perturbed_episodes_apart():
    plan = cells(("a", "b"), ("maniskill/A",), (Condition(), Condition("noise", 2)))
    results = with_behaviour(rows_where(lambda cell, seed: cell.condition == Condition(), plan, 10))
    run = Run("night", document(10, plan), columns_of(results, PAIRWISE_COLUMNS))
    (one,) = compare_policies(PolicyRows.of_run(run, "a"), PolicyRows.of_run(run, "b")).comparisons
    assert (one.behaviour.pairs, one.behaviour.changes) == (10, ())
    assert [(c.first, c.second, c.pairs) for c in one.perturbed_changes] == [("not-reached", "not-reached", 10)]
    assert compare_all(run).comparisons[0].behaviour == one.behaviour


def test_a_run_is_compared_with_its_baseline():
    plan = cells(("a",), ("maniskill/A",))
    runs = [
        Run(name, document(12, plan), columns_of(longer_by(0.0, 12, plan), PAIRWISE_COLUMNS)) for name in ("x", "y")
    ]
    runs[0].rows["path_length"] += 0.1
    (policy,) = compare_runs(*runs).comparisons
    (line,) = policy.behaviour.measures
    assert line.difference.value == pytest.approx(0.1)
    assert line.p < 0.001
