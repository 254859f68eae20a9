"""How robots move in clean episodes."""

from dataclasses import replace

import pytest

from robogauntlet.results.report.sections.behaviour import COLUMNS, MOST_ROWS, Spread, build_behaviour
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, columns_of, document, row, rows, rows_where, with_behaviour

CELL = cells(("a",), ("maniskill/A",))[0]


def found(plan, results):
    return build_behaviour(document(len(results), plan), columns_of(results, COLUMNS))


def test_rows_of_earlier_versions_have_none():
    plan = cells(("a",))
    assert found(plan, rows(plan)) is None
    assert found(plan, []) is None


def test_path_time_and_smoothness_are_of_successes_only():
    lengths = [0.1, 0.2, 0.3, 0.4, 0.5]
    results = [row(CELL, seed, path_length=length, smoothness=-2.0) for seed, length in enumerate(lengths)]
    results.append(row(CELL, 9, "failure", path_length=7.0, smoothness=-9.0))
    (one,) = found([CELL], results)
    assert one.path_length == Spread(pytest.approx(0.3), pytest.approx(0.2), pytest.approx(0.4))
    assert one.smoothness == Spread(-2.0, -2.0, -2.0)
    assert one.time_to_success is None
    assert (one.successes, one.episodes) == (5, 6)


def test_steps_are_shares_of_all_control_steps():
    results = [
        row(CELL, 0, contact_steps=10, contact_force=3.0, joint_limit_steps=0),
        row(CELL, 1, "failure", contact_steps=4, contact_force=40.5, joint_limit_steps=0),
    ]
    (one,) = found([CELL], results)
    assert one.contact_steps == pytest.approx(14 / 140)
    assert (one.contact_force, one.joint_limit_steps, one.workspace_steps) == (40.5, 0.0, None)


def test_errors_and_perturbed_episodes_do_not_count():
    plan = cells(("a",), ("maniskill/A",), (Condition(), Condition("noise", 2)))
    results = with_behaviour(rows_where(lambda cell, seed: True, plan, 4))
    results[0] = row(plan[0], 0, "error")
    (one,) = found(plan, results)
    assert one.episodes == 3


def test_a_run_without_successes_has_the_progress_of_its_failures():
    (one,) = found([CELL], with_behaviour(rows_where(lambda cell, seed: False, [CELL], 5)))
    assert one.path_length is None
    assert one.progress == one.progress_of_failures
    assert one.progress.median < 1


def test_many_tasks_are_summarised_by_simulator():
    plan = cells(("a",), [f"maniskill/T{number}" for number in range(MOST_ROWS + 1)])
    (one,) = found(plan, with_behaviour(rows_where(lambda cell, seed: True, plan, 2)))
    assert (one.task, one.episodes) == (None, 2 * (MOST_ROWS + 1))


def test_a_renamed_policy_keeps_its_episodes():
    results = [replace(result, policy="before") for result in with_behaviour([row(CELL, 0)])]
    assert [one.policy for one in found([CELL], results)] == ["a"]
