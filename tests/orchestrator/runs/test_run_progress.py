"""How far a run is."""

import pytest

from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.run_progress import RunProgress
from robogauntlet.results.store.history_records import Counts
from tests.results.synthetic import row

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
    assert (live.per_minute, live.left_s) == (15.0, 35 / 15 * 60)


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
