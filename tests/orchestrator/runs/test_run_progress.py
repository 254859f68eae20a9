"""How far a run is."""

from dataclasses import replace

import pytest

from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.run_progress import RunProgress
from robogauntlet.results.store.history_records import Counts
from robogauntlet.support.durations import format_range
from tests.results.synthetic import row

TWO = """
name: two
policies: [oracle]
tasks: [null/Reach, pybullet/PandaReach-v3]
seeds: {count: 10}
"""
SUITE = """
name: nulls
policies: [oracle, random]
tasks: [null/Reach, null/Slow]
conditions: [clean, "noise@2"]
seeds: {count: 5}
"""


@pytest.fixture
def plan(suite_file):
    return make_plan(suite_file(SUITE))


@pytest.fixture
def clock():
    return [0.0]


@pytest.fixture
def progress(plan, clock):
    return RunProgress(plan, {}, now=lambda: clock[0])


@pytest.fixture
def rows(plan):
    """Rows of a policy under a condition."""

    def make(status, count, policy="oracle", axis="clean"):
        cell = next(cell for cell in plan.cells if (cell.policy, cell.condition.axis) == (policy, axis))
        return [row(cell, seed, status) for seed in range(count)]

    return make


def conditions(progress):
    return {(policy, axis, severity): counts for policy, axis, severity, counts in progress.conditions()}


def test_outcomes_and_pace_of_a_simulator_are_counted(progress, rows, clock):
    assert progress.started("null")
    assert not progress.started("null")
    clock[0] = 10.0
    progress.count([*rows("success", 3), *rows("failure", 1), *rows("error", 1, "random")])
    clock[0] = 20.0
    (live,) = progress.simulators()
    assert (live.planned, live.successes, live.failures, live.errors, live.done) == (40, 3, 1, 1, 5)
    assert live.per_minute == 15.0


def played(plan, simulator, seconds, **telemetry):
    cell = next(cell for cell in plan.cells if cell.simulator == simulator)
    return [row(cell, seed, wall_s=wall_s, **telemetry) for seed, wall_s in enumerate(seconds)]


def test_the_time_left_is_the_work_left_by_the_workers_that_were_busy(plan, progress, rows, clock):
    progress.started("null")
    assert progress.left_s() is None
    clock[0] = 10.0  # two workers, each with five episodes of two seconds
    progress.count([replace(one, wall_s=2.0) for policy in ("oracle", "random") for one in rows("success", 5, policy)])
    assert progress.left_s() == (30.0, 30.0)
    clock[0] = 200.0
    assert progress.left_s() is None  # nothing came back in the last minute


def test_the_time_left_is_a_range_while_few_episodes_are_known(plan, progress, rows, clock):
    progress.started("null")
    clock[0] = 8.0
    progress.count([replace(one, wall_s=wall_s) for one, wall_s in zip(rows("success", 2), (2.0, 6.0), strict=True)])
    low, high = progress.left_s()
    assert low == 38 * 2.0
    assert high == 38 * 8.0


def test_a_simulator_that_has_not_begun_is_unknown_and_not_slow(suite_file):
    plan, clock = make_plan(suite_file(TWO)), [0.0]
    progress = RunProgress(plan, {}, now=lambda: clock[0])
    progress.started("null")
    clock[0] = 12.0
    progress.count(played(plan, "null", [1.0] * 8, build_s=0.5))
    assert progress.left_s() == (12.0, 12.0 + 4.0)  # one worker; another task is to be opened
    progress.count(played(plan, "pybullet", [9.0, 9.0]))
    assert progress.left_s()[0] == pytest.approx((2 * 1.0 + 8 * 9.0) * 12 / (8 + 4 + 18))


@pytest.mark.parametrize(
    ("ends", "text"),
    [
        ((3, 3.2), "3 s"),
        ((20, 50), "20 to 50 s"),
        ((0.2, 0.3), "at most 1 s"),
        ((50, 100), "1 to 2 min"),
        ((170, 490), "3 to 8 min"),
        ((4000, 9000), "1 to 2 h"),
    ],
)
def test_a_range_is_in_the_unit_of_its_end(ends, text):
    assert format_range(*ends) == text


def test_a_pace_is_that_of_the_last_minute(progress, rows, clock):
    assert progress.simulators()[0].per_minute is None
    progress.started("null")
    progress.count(rows("success", 3))
    clock[0] = 61.0
    progress.count(rows("failure", 2))
    assert progress.simulators()[0].per_minute == 2.0


def test_policies_and_conditions_are_never_pooled(progress, rows):
    progress.count([*rows("success", 3), *rows("failure", 1), *rows("failure", 2, axis="noise")])
    progress.count([*rows("success", 5, "random"), *rows("error", 4, "random")])
    assert conditions(progress) == {
        ("oracle", "clean", 0): Counts(0, 3, 1, 0),
        ("oracle", "noise", 2): Counts(0, 0, 2, 0),
        ("random", "clean", 0): Counts(0, 5, 0, 4),
    }


def test_a_continued_run_counts_the_rows_that_it_has(plan, rows):
    digest = plan.cells[0].policy_digest
    stored = {(digest, "null/Reach", "clean", 0): Counts(0, 1, 1), ("another", "null/Reach", "clean", 0): Counts(0, 2)}
    progress = RunProgress(plan, stored)
    progress.count(rows("success", 2))
    assert conditions(progress) == {("oracle", "clean", 0): Counts(0, 3, 1, 0)}
    assert progress.simulators()[0].done == 6


def test_the_plan_may_grow_from_round_to_round(plan, progress):
    progress.replan({plan.cells[0]: 7, plan.cells[1]: 2})
    assert progress.simulators()[0].planned == 9
