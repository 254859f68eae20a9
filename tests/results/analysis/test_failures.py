"""Counts of the kinds of failures."""

from dataclasses import replace

import pytest

from robogauntlet.results.analysis.failures import COLUMNS, COMBINATIONS, OTHER, build_failures
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.suites.episode import Condition, Perturbation
from tests.results.synthetic import CLEAN, cells, columns_of, document, row, rows, rows_where, with_behaviour

TASK = ("maniskill/A",)
ORBIT = tuple(Condition("camera-orbit", severity) for severity in (2, 4))


def found(plan, results, **changes):
    return build_failures(document(len(results), plan, **changes), columns_of(results, COLUMNS))


def played(conditions=CLEAN, policies=("a",), tasks=TASK, kind=lambda row: "dropped", won=lambda c, s: s % 2):
    plan = cells(policies, tasks, conditions)
    return plan, with_behaviour(rows_where(won, plan, 10), kind)


def test_rows_of_earlier_versions_have_none():
    plan = cells(("a",))
    assert found(plan, rows(plan)) is None
    assert found(plan, []) is None


def test_a_run_without_failures_has_none():
    assert found(*played(won=lambda cell, seed: True)) is None


def test_failures_under_a_control_do_not_count():
    (one,) = found(*played((Condition(), Condition("blind", 1)))).policies
    assert (one.total.episodes, one.total.failures) == (10, 5)
    assert found(*played((Condition("blind", 1),))) is None


def test_each_episode_is_in_one_outcome():
    plan, results = played(kind=lambda row: "dropped" if row.seed < 6 else None)
    results[1] = row(plan[0], 1, "error")
    (one,) = found(plan, results).policies
    assert {name: one.total.count(name) for name in found(plan, results).outcomes} == {
        **{"success": 4, "dropped": 3},
        **{OTHER: 2, "error": 1},
    }
    assert (one.total.episodes, one.total.failures, one.total.errors) == (10, 5, 1)


def test_shares_are_of_the_failures_with_wilson_intervals():
    (one,) = found(*played(kind=lambda row: "dropped" if row.seed < 6 else "misplaced")).policies
    dropped, misplaced = one.total.kinds
    assert (dropped.share, dropped.interval) == (0.6, wilson_interval(3, 5))
    assert (misplaced.failures, misplaced.share) == (2, 0.4)


def test_failures_from_one_start_state_count_as_alike():
    """Two severities, at both of which the same seeds fail in the same way: as informative as one of them."""
    plan, results = played(ORBIT, kind=lambda row: "dropped" if row.seed < 6 else "misplaced")
    (one,) = found(plan, results).policies
    dropped = one.total.kinds[0]
    single, double = wilson_interval(3, 5), wilson_interval(6, 10)
    assert (dropped.failures, dropped.share) == (6, 0.6)
    assert dropped.interval.high - dropped.interval.low >= single.high - single.low > double.high - double.low


def test_failures_that_are_all_of_one_kind_are_as_informative_as_their_start_states():
    (one,) = found(*played(ORBIT, won=lambda cell, seed: seed >= 3)).policies
    (dropped,) = one.total.kinds
    assert (dropped.failures, dropped.share, dropped.interval) == (6, 1.0, wilson_interval(3, 3))


def test_severities_of_an_axis_are_counted_together_after_the_clean_condition():
    failures = found(*played((*ORBIT, Condition())))
    assert not failures.by_task
    assert [(group.name, group.episodes) for group in failures.policies[0].groups] == [
        ("clean", 10),
        ("camera-orbit", 20),
    ]


def test_a_severity_between_the_whole_ones_is_counted_with_its_axis():
    between = Condition.of(Perturbation("camera-orbit", 2.5))
    both = Condition.of(Perturbation("camera-orbit", 2.5), Perturbation("noise", 1))
    (one,) = found(*played((Condition(), between, *ORBIT, both))).policies
    assert [(group.name, group.episodes) for group in one.groups] == [
        ("clean", 10),
        ("camera-orbit", 30),
        (COMBINATIONS, 10),
    ]


def test_a_clean_run_is_counted_by_task():
    failures = found(*played(tasks=("maniskill/A", "maniskill/B", "pybullet/C")))
    assert failures.by_task
    assert [[group.name for group in one.groups] for one in failures.policies] == [
        ["maniskill/A", "maniskill/B"],
        ["pybullet/C"],
    ]


@pytest.mark.parametrize("unknown", ["melted", "", "<script>", "DROPPED"])
def test_a_kind_of_another_version_is_counted_as_other(unknown):
    plan, results = played(kind=lambda row: unknown if row.seed else "dropped")
    (one,) = found(plan, results).policies
    assert {kind.kind: kind.failures for kind in one.total.kinds} == {"dropped": 1, OTHER: 4}
    assert one.total.most.kind == "dropped"


def test_a_kind_counts_only_in_failures():
    plan, results = played()
    results = [replace(result, failure="unsafe") if result.status == "success" else result for result in results]
    assert found(plan, results).kinds == ("dropped",)


def test_thousands_of_combinations_are_counted_by_axis():
    points = [
        Condition.of(Perturbation("noise", (number % 400 + 1) / 100), Perturbation("table", 1 + number // 400))
        for number in range(2000)
    ]
    plan = cells(("a",), TASK, points)
    results = with_behaviour([row(cell, 0, "failure") for cell in plan], lambda row: "not-reached")
    (one,) = found(plan, results).policies
    assert [(group.name, group.failures) for group in one.groups] == [
        (COMBINATIONS, 2000),
        ("noise 2 or more", 1005),
        ("table 2.5 or more", 1200),
    ]


def test_the_oracle_gate_and_no_skill_baselines_are_left_out():
    plan, results = played(policies=("a", "oracle", "random"))
    suite = {"policies": ["a", "oracle", "random"], "oracle_gate": "oracle", "no_skill_baselines": ["random"]}
    assert [one.policy for one in found(plan, results, **suite).policies] == ["a"]
