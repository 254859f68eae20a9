"""Tests of results/analysis/tables.py and results/analysis/timing.py."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.results.analysis.tables import COLUMNS, build_tables
from robogauntlet.results.analysis.timing import AnswerTiming, answer_timing
from robogauntlet.results.report import write_report
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, frame_of, row, rows, run_folder, tables_of

ONE = cells(("oracle",), ("maniskill/PushCube-v1",))
THREE = (Condition("light", 3), Condition(), Condition("camera", 1))


def tables_for(statuses, planned=None, **changes):
    results = [row(ONE[0], seed, status) for seed, status in enumerate(statuses)]
    return tables_of(document(len(statuses) if planned is None else planned, ONE, **changes), results)


def test_an_error_is_not_a_failure():
    tally = tables_for(["success"] * 6 + ["failure"] * 2 + ["error"] * 2).cells[0].tally
    assert (tally.planned, tally.done, tally.successes, tally.failures, tally.errors) == (10, 10, 6, 2, 2)
    assert tally.rate == 0.75
    assert tally.interval == wilson_interval(6, 8)
    assert (tally.bounds.low, tally.bounds.high) == (0.6, 0.8)


def test_errors_alone_give_no_rate():
    tally = tables_for(["error"] * 3).cells[0].tally
    assert (tally.rate, tally.interval, tally.success_once, tally.mean_steps, tally.mean_seconds) == (None,) * 5
    assert (tally.bounds.low, tally.bounds.high) == (0, 1)


def test_without_errors_and_gaps_there_are_no_bounds():
    assert tables_for(["success", "failure"]).cells[0].tally.bounds is None


def test_missing_episodes_are_counted_and_named():
    tables = tables_for(["success"] * 4, planned=10, status=RunStatus.INTERRUPTED, reason="Ctrl-C")
    tally = tables.cells[0].tally
    assert (tally.done, tally.missing) == (4, 6)
    assert (tally.rate, tally.bounds.low, tally.bounds.high) == (1, 0.4, 1)
    gap = tables.not_run[0]
    assert (gap.task, gap.policy) == ("maniskill/PushCube-v1", "oracle")
    assert (gap.missing, gap.reason) == (6, "run interrupted: Ctrl-C")


def test_a_skipped_simulator_is_missing_with_its_reason():
    present = [cell for cell in cells() if cell.simulator != "robosuite"]
    tables = tables_of(document(5, skipped={"robosuite": "not installed"}), rows(present, 5))
    assert tables.skipped == (("robosuite", "not installed"),)
    assert {gap.reason for gap in tables.not_run} == {"not installed"}
    assert sum(gap.missing for gap in tables.not_run) == 10
    assert tables.total.planned == 40
    assert "robosuite" in tables.simulators


def test_a_run_without_rows_gives_tables_without_rates():
    tables = tables_of(document(5), [])
    assert (tables.total.planned, tables.total.done, tables.total.missing) == (40, 0, 40)
    assert all(cell.tally.rate is None for cell in tables.cells)
    assert (tables.timing, tables.errors) == ((), ())


def test_a_run_without_a_plan_gives_empty_tables():
    tables = tables_of(document(plan=()), [])
    assert (tables.cells, tables.by_policy, tables.total.planned) == ((), (), 0)


def test_rows_outside_the_plan_are_shown_with_nothing_planned():
    extra = cells(("random",), ("pybullet/PandaPush-v3",))[0]
    tables = tables_of(document(1, ONE), [row(ONE[0], 0), row(extra, 0)])
    assert [cell.policy for cell in tables.cells] == ["oracle", "random"]
    assert (tables.cells[1].tally.planned, tables.cells[1].tally.done, tables.cells[1].tally.missing) == (0, 1, 0)


def test_a_renamed_policy_keeps_its_episodes():
    renamed = [dataclasses.replace(row(ONE[0], seed), policy="old name") for seed in range(3)]
    tables = tables_of(document(3, ONE), renamed)
    assert [(cell.policy, cell.tally.done) for cell in tables.cells] == [("oracle", 3)]


def test_cells_come_in_the_order_of_the_plan():
    plan = cells(("zeta", "alpha"), ("robosuite/Lift", "maniskill/PushCube-v1"), THREE)
    tables = tables_of(document(2, plan), rows(plan, 2)[::-1])
    assert [(c.policy, c.task, c.condition) for c in tables.cells] == [(c.policy, c.task, c.condition) for c in plan]
    assert tables.policies == ("zeta", "alpha")
    assert tables.simulators == ("robosuite", "maniskill")
    assert tables.conditions == (Condition(), Condition("light", 3), Condition("camera", 1))


def test_conditions_are_never_pooled():
    plan = cells(("oracle",), ("robosuite/Lift",), (Condition(), Condition("light", 3)))
    results = [row(plan[0], s) for s in range(4)] + [row(plan[1], s, "failure") for s in range(4)]
    tables = tables_of(document(4, plan), results)
    assert [(str(a.condition), a.tally.rate) for a in tables.by_policy] == [("clean", 1.0), ("light@3", 0.0)]
    assert len(tables.by_simulator) == 2


def test_pooled_weighs_episodes_and_the_task_mean_weighs_tasks():
    plan = cells(("oracle",), ("maniskill/PushCube-v1", "maniskill/PickCube-v1"))
    results = [row(plan[0], s) for s in range(6)] + [row(plan[1], s, "failure") for s in range(2)]
    results += [row(plan[1], s, "error") for s in range(2, 6)]
    total = tables_of(document(6, plan), results).by_policy[0]
    assert (total.tally.rate, total.task_mean, total.tasks) == (0.75, 0.5, 2)
    assert total.simulator is None


def test_means_are_over_episodes_with_a_verdict():
    results = [row(ONE[0], 0, steps=40, wall_s=2.0), row(ONE[0], 1, "failure", steps=100, wall_s=4.0)]
    results.append(row(ONE[0], 2, "error", wall_s=500.0))
    tally = tables_of(document(3, ONE), results).cells[0].tally
    assert (tally.mean_steps, tally.mean_seconds) == (70, 3)


def test_success_once_is_counted_apart_from_success():
    results = [row(ONE[0], 0), row(ONE[0], 1, "failure", success_once=True), row(ONE[0], 2, "failure")]
    tally = tables_of(document(3, ONE), results).cells[0].tally
    assert (tally.rate, tally.success_once) == (pytest.approx(1 / 3), pytest.approx(2 / 3))


def test_errors_are_grouped_by_message_the_most_frequent_first():
    results = [row(ONE[0], 0, "error", error="rare")]
    results += [row(ONE[0], seed, "error", error="frequent") for seed in range(1, 9)]
    groups = tables_of(document(9, ONE), results).errors
    assert [(group.message, group.count) for group in groups] == [("frequent", 8), ("rare", 1)]
    assert groups[0].examples == tuple(ONE[0].episode(seed).id for seed in (1, 2, 3))
    assert groups[0].tasks == ("maniskill/PushCube-v1",)


def test_phase_timing_adds_up_and_errors_took_time_too():
    results = [row(ONE[0], 0, build_s=10.0, load_s=2.0), row(ONE[0], 1, "error", wall_s=1.0, worker="maniskill-0")]
    (line,) = tables_of(document(2, ONE), results).timing
    assert (line.simulator, line.episodes, line.workers) == ("maniskill", 2, 1)
    assert (line.build_s, line.load_s, line.reset_s, line.render_s, line.wall_s) == (10, 2, 0.25, 1, 3)
    assert line.rest_s == pytest.approx(3 - 1.875)
    assert line.total_s == pytest.approx(10 + 2 + 3 + 0.125)
    assert line.busy_share == pytest.approx(1.875 / 3.125)
    assert line.episodes_per_worker_hour == pytest.approx(2 * 3600 / 15.125)
    phases = ("build", "load", "reset", "physics", "render", "inference", "rest", "wait")
    assert sum(map(line.seconds, phases)) == pytest.approx(line.total_s)


def test_timing_without_any_time_has_no_shares():
    empty = dict.fromkeys(("reset_s", "physics_s", "render_s", "inference_s", "wait_s", "wall_s"), 0.0)
    (line,) = tables_of(document(1, ONE), [row(ONE[0], 0, **empty)]).timing
    assert (line.busy_share, line.episodes_per_worker_hour) == (None, None)


def times(seed, median, late, longest):
    return row(ONE[0], seed, query_p50_s=median, query_p95_s=late, query_max_s=longest)


def test_times_are_medians_over_episodes_except_for_the_longest():
    frame = frame_of([times(0, 0.1, 0.3, 0.4), times(1, 0.2, 0.4, 9.0), times(2, 0.3, 0.5, 0.6), row(ONE[0], 3)])
    assert answer_timing(frame) == (AnswerTiming(ONE[0].policy, 3, 0.2, 0.4, 9.0),)


def test_rows_without_query_times_have_no_timing():
    frame = frame_of([row(ONE[0], 0)])
    assert answer_timing(frame) == ()


statuses = st.lists(st.sampled_from(["success", "failure", "error"]), max_size=12)


@settings(max_examples=25)
@given(st.lists(statuses, min_size=4, max_size=4), st.integers(12, 15))
def test_nothing_is_lost_or_counted_twice(outcomes, planned):
    plan = cells(("oracle", "random"), ("maniskill/PushCube-v1", "robosuite/Lift"))
    results = [row(c, seed, s) for c, column in zip(plan, outcomes, strict=True) for seed, s in enumerate(column)]
    tables = tables_of(document(planned, plan), results)
    for tallies in ([c.tally for c in tables.cells], [a.tally for a in tables.by_simulator], [tables.total]):
        assert sum(t.done for t in tallies) == len(results)
        assert sum(t.done + t.missing for t in tallies) == sum(t.planned for t in tallies) == 4 * planned
        assert sum(t.errors for t in tallies) == sum(r.status == "error" for r in results)
        for t in tallies:
            assert t.done == t.successes + t.failures + t.errors
            assert (t.rate is None) == (t.verdicts == 0)
            assert t.bounds is None or t.rate is None or t.bounds.low <= t.rate <= t.bounds.high


def test_a_report_and_its_records_give_the_same_tables(tmp_path):
    run, results = document(6, skipped={"gazebo": "absent"}), rows(planned=6, errors=1)
    folder = run_folder(tmp_path / "run", run, results)
    ordered = sorted(results, key=lambda r: (r.simulator, r.task, r.policy, r.seed))
    assert write_report(folder).tables == tables_of(run, ordered)


def test_a_million_rows_are_counted_exactly():
    base = frame_of(rows(planned=5, errors=1))
    frame = base.iloc[np.arange(1_000_000) % len(base)].reset_index(drop=True)
    assert isinstance(frame["task"].dtype, pd.CategoricalDtype)
    tables = build_tables(document(125_000), frame)
    assert tables.total.done == 1_000_000
    assert set(frame.columns) == set(COLUMNS)
