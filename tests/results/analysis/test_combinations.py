"""Which axes matter and where failures gather, in runs that were never played."""

import numpy as np
import pytest

from robogauntlet.results.analysis import combinations
from robogauntlet.results.analysis.combinations import build_combinations, cluster_failures, is_inside
from robogauntlet.suites.designs import DesignEntry
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, columns_of, document, row, rows_where

AXES = ["table", "illuminance", "noise"]
SPREAD = {"kind": "latin-hypercube", "axes": AXES, "points": 200}
SOBOL = {"kind": "sobol", "axes": AXES, "points": 64}
TASKS = ("maniskill/A", "robosuite/B")
SEEDS = 4


def severities(condition):
    return {part.axis: part.severity for part in condition.perturbations}


def chance(cell, seed):
    """A number in [0, 1) that depends on the episode alone."""
    return np.random.default_rng(int(cell.episode(seed).id, 16)).random()


def fails_in_the_dark_on_another_table(cell, seed):
    found = severities(cell.condition)
    both = found.get("table", 0) >= 3 and found.get("illuminance", 0) >= 2
    return chance(cell, seed) > (0.9 if both else 0.05)


def played(design, succeeds, tasks=TASKS, policies=("a",), seeds=SEEDS, **changes):
    conditions = (Condition(), *dict.fromkeys(DesignEntry.model_validate(design).conditions()))
    plan = cells(policies, tasks, conditions)
    return document(seeds, plan, design=design, tasks=list(tasks), **changes), rows_where(succeeds, plan, seeds)


def built(design, succeeds, **changes):
    run, rows = played(design, succeeds, **changes)
    return build_combinations(run, columns_of(rows, combinations.COLUMNS))


@pytest.fixture(scope="module")
def planted():
    return built(SPREAD, fails_in_the_dark_on_another_table)


def test_there_is_a_result_for_each_simulator(planted):
    assert (planted.design, planted.axes) == ("latin-hypercube", tuple(AXES))
    assert [(one.policy, one.simulator, one.tasks) for one in planted.policies] == [
        ("a", "maniskill", 1),
        ("a", "robosuite", 1),
    ]
    assert all((one.points, one.episodes) == (200, 200 * SEEDS) for one in planted.policies)
    assert all(one.clean.value > 0.7 and one.success.value < one.clean.value for one in planted.policies)


def test_a_planted_cluster_is_found_in_each_simulator_and_only_that(planted):
    for one in planted.policies:
        (cluster,) = one.clusters
        assert {(c.axis, c.threshold) for c in cluster.conditions} == {("table", 3), ("illuminance", 2)}
        assert cluster.within.interval.low < 0.9 < cluster.within.interval.high
        assert one.pair.axes == ("table", "illuminance")


def test_effects_count_each_axis_whatever_the_others_are(planted):
    effects = {effect.axis: effect.rates for effect in planted.policies[0].effects}
    assert effects["table"][1].value > 0.9 > 0.6 > effects["table"][5].value
    assert effects["noise"][0] is None  # no point has none of it


def test_the_shares_of_the_axes_are_found_by_a_sobol_design():
    def by_table(cell, seed):
        return chance(cell, seed) > severities(cell.condition).get("table", 0) / 5

    found = built(SOBOL, by_table, tasks=TASKS[:1])
    (one,) = found.policies
    indices = {axis.axis: axis for axis in one.sensitivity.axes}
    assert indices["table"].total.value > 0.8
    assert all(indices[axis].total.value < 0.2 for axis in ("illuminance", "noise"))
    assert one.why_no_sensitivity == ""
    assert [c.axis for cluster in one.clusters for c in cluster.conditions] == ["table"]


def test_simulators_are_compared_by_their_total_indices():
    def by_all(cell, seed):
        found = severities(cell.condition)
        risk = 0.15 * found.get("table", 0) + 0.05 * found.get("illuminance", 0)
        return chance(cell, seed) > min(0.95, risk)

    (row,) = built(SOBOL, by_all).agreement
    assert (row.one, row.other, row.axes) == ("maniskill", "robosuite", 3)
    assert row.tau > 0


@pytest.mark.parametrize(
    ("design", "seeds", "why"),
    [
        (SPREAD, 4, "indices need a suite with design: {kind: sobol}"),
        ({**SOBOL, "points": 2}, 1, "indices need two base points at which two start states have a verdict"),
    ],
)
def test_missing_indices_have_a_reason(design, seeds, why):
    (one,) = built(design, lambda cell, seed: seed % 2, tasks=TASKS[:1], seeds=seeds).policies
    assert one.sensitivity is None
    assert one.why_no_sensitivity.startswith(why)


def with_errors(fails):
    """By the table alone; with errors where this is true of a cell's number and the seed."""
    run, rows = played(SOBOL, lambda cell, seed: severities(cell.condition).get("table", 0) < 2.5, tasks=TASKS[:1])
    planned = enumerate(cells(("a",), TASKS[:1], SOBOL_CONDITIONS))
    errors = [row(cell, seed, "error") for number, cell in planned for seed in range(SEEDS) if fails(number, seed)]
    failed = {error.episode_id: error for error in errors}
    rows = [failed.get(r.episode_id, r) for r in rows]
    (one,) = build_combinations(run, columns_of(rows, combinations.COLUMNS)).policies
    assert one.episodes == len(rows) - SEEDS - len(failed)
    return one


def test_a_seed_with_many_errors_is_left_out_of_the_indices_only():
    one = with_errors(lambda number, seed: seed == 1 and number % 3 == 0)
    assert (one.base_points_left_out, one.start_states_left_out) == (0, 1)
    assert one.sensitivity.axes[0].total.value == pytest.approx(1, abs=0.01)


def test_two_base_points_that_two_seeds_share_have_indices():
    rows = len(SOBOL["axes"]) + 2
    one = with_errors(lambda number, seed: number // rows > 1 or (number // rows == 1 and seed > 1))
    assert one.sensitivity is not None
    assert one.start_states_left_out == SEEDS - 2


def test_a_base_point_with_an_error_is_left_out_of_the_indices_only():
    one = with_errors(lambda number, seed: (number, seed) in ((1, 0), (2, 3)))
    assert (one.base_points_left_out, one.start_states_left_out) == (1, 0)
    assert one.sensitivity.axes[0].total.value == pytest.approx(1, abs=0.05)


SOBOL_CONDITIONS = DesignEntry.model_validate(SOBOL).conditions()


def test_the_oracle_gate_and_its_policy_are_left_out():
    def oracle_needs_light(cell, seed):
        return cell.policy != "oracle" or severities(cell.condition).get("illuminance", 0) < 4

    found = built(SPREAD, oracle_needs_light, policies=("oracle", "a"), oracle_gate="oracle", tasks=TASKS[:1])
    (one,) = found.policies
    assert one.policy == "a"
    assert one.episodes == 160 * SEEDS  # a fifth of the points has no light


def test_tasks_that_count_at_different_points_are_not_compared_with_each_other():
    """One task always fails more often; the gate leaves one out where the object is far, the other elsewhere."""

    def succeeds(cell, seed):
        far = severities(cell.condition).get("noise", 0) >= 3
        if cell.policy == "oracle":
            return far == (cell.task == "maniskill/A") or cell.condition == Condition()
        return chance(cell, seed) > (0.8 if cell.task == "maniskill/A" else 0.1)

    found = built(
        SPREAD, succeeds, tasks=("maniskill/A", "maniskill/B"), policies=("oracle", "a"), oracle_gate="oracle"
    )
    assert [one.clusters for one in found.policies] == []


def test_conditions_of_other_versions_are_left_out():
    odd = ("a@b+c", "x@", "noise@inf", "noise@9+table@1", "noise@-1+table@1", "other-axis@2+table@1")
    conditions = (Condition(), Condition("noise@1+table@2", 1), *(Condition(text, 1) for text in odd))
    plan = cells(("a",), TASKS[:1], conditions)
    rows = rows_where(lambda cell, seed: True, plan, SEEDS)
    found = build_combinations(document(SEEDS, plan), columns_of(rows, combinations.COLUMNS))
    assert found.axes == ("table", "noise", "other-axis")
    assert found.policies[0].episodes == 2 * SEEDS


def test_the_video_of_a_cluster_is_of_an_episode_that_the_oracle_solves():
    def succeeds(cell, seed):
        if cell.policy == "oracle":
            return severities(cell.condition).get("table", 0) >= 4 or cell.condition == Condition() or seed != 0
        return fails_in_the_dark_on_another_table(cell, seed)

    changes = {"policies": ("oracle", "a"), "oracle_gate": "oracle", "tasks": TASKS[:1], "seeds": 40}
    run, rows = played({**SPREAD, "points": 60}, succeeds, **changes)
    found = build_combinations(run, columns_of(rows, combinations.COLUMNS))
    assert {row.seed == 0 for row in cluster_failures(found, rows)} == {False}


def test_listed_combinations_are_summarised_without_a_design():
    conditions = (Condition(), Condition("noise", 2), *(Condition(f"noise@{n}+table@{n}", 1) for n in range(1, 5)))
    plan = cells(("a",), TASKS[:1], conditions)
    rows = rows_where(lambda cell, seed: True, plan, SEEDS)
    found = build_combinations(document(SEEDS, plan), columns_of(rows, combinations.COLUMNS))
    assert (found.design, found.axes) == (None, ("table", "noise"))
    assert found.policies[0].episodes == 4 * SEEDS


def test_a_run_without_combinations_has_none():
    plan = cells(("a",), TASKS[:1], (Condition(), Condition("noise", 2)))
    rows = rows_where(lambda cell, seed: True, plan, SEEDS)
    assert build_combinations(document(SEEDS, plan), columns_of(rows, combinations.COLUMNS)) is None
    assert cluster_failures(None, rows) == []


def test_the_video_of_a_cluster_is_its_mildest_failure_whose_clean_episode_succeeded():
    run, rows = played(SPREAD, fails_in_the_dark_on_another_table)
    found = build_combinations(run, columns_of(rows, combinations.COLUMNS))
    chosen = cluster_failures(found, rows)
    assert [row.simulator for row in chosen] == ["maniskill", "robosuite"]
    for row_, one in zip(chosen, found.policies, strict=True):
        solved = {r.seed for r in rows if (r.task, r.axis, r.status) == (row_.task, "clean", "success")}
        failures = [r for r in rows if r.task == row_.task and r.status == "failure" and r.seed in solved]
        inside = [r for r in failures if is_inside(r.episode.condition, one.clusters[0])]
        mildest = min(inside, key=lambda r: (sum(severities(r.episode.condition).values()), r.seed))
        assert row_ == mildest


def test_the_same_rows_in_another_order_give_the_same_result():
    run, rows = played(SPREAD, fails_in_the_dark_on_another_table)
    once, again = (build_combinations(run, columns_of(r, combinations.COLUMNS)) for r in (rows, rows[::-1]))
    assert once == again
