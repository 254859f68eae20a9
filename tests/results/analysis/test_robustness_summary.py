"""All axes of a policy in a few numbers, and whether simulators agree."""

import numpy as np
import pytest

from robogauntlet.results.analysis.eligible_episodes import select_eligible
from robogauntlet.results.analysis.robustness_summary import build_robustness_summary
from robogauntlet.results.record import FIELDS
from robogauntlet.results.report.robustness import agreement_findings, agreement_table, summary_table
from robogauntlet.results.statistics.rank_agreement import kendall
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, columns_of, document, rows_where

TASKS = ("maniskill/PushCube-v1", "robosuite/Lift")
AXES = ("noise", "blur", "illuminance", "table", "camera-orbit")
CLEAN = Condition()
LEVELS = [Condition(axis, severity) for axis in AXES for severity in (2, 4)]
PLAN = cells(("oracle", "experts"), TASKS, [CLEAN, *LEVELS])
SEEDS = 20


def played(wins, plan=PLAN, seeds=SEEDS):
    """Rows in which the experts win the first `wins(cell)` seeds and the oracle wins all."""
    results = rows_where(lambda cell, seed: cell.policy == "oracle" or seed < wins(cell), plan, seeds)
    return columns_of(results, FIELDS)


def overall(wins, plan=PLAN, **options):
    run = document(SEEDS, plan, oracle_gate="oracle", **options)
    return build_robustness_summary(run, select_eligible(run, played(wins, plan)))


def of(found, simulator=None):
    return next(r for r in found.rows if r.simulator == simulator)


def by_axis(cell):
    """Fewer wins from axis to axis, alike in both simulators."""
    return SEEDS if cell.condition == CLEAN else 18 - 3 * AXES.index(cell.condition.axis)


def test_the_mean_of_the_levels_and_the_worst_axis_are_known():
    found = of(overall(by_axis))
    assert (found.conditions, found.mean) == (10, pytest.approx(np.mean([(18 - 3 * i) / SEEDS for i in range(5)])))
    assert (found.worst_axis, found.worst) == ("camera-orbit", pytest.approx(0.3))


def test_the_gate_and_no_skill_baselines_have_no_rows():
    plan = cells(("oracle", "experts", "random"), TASKS, [CLEAN, *LEVELS])
    found = overall(by_axis, plan, no_skill_baselines=("random",))
    assert {r.policy for r in found.rows} == {"experts"}


def test_simulators_that_order_axes_alike_agree_and_those_that_do_not_disagree():
    (alike,) = overall(by_axis).agreement
    assert (alike.one, alike.other, alike.axes) == ("maniskill", "robosuite", 5)
    assert (alike.tau, alike.violation) == (pytest.approx(1.0), 0.0)

    def opposite(cell):
        if cell.condition == CLEAN:
            return SEEDS
        place = AXES.index(cell.condition.axis)
        return 18 - 3 * (place if cell.simulator == "maniskill" else 4 - place)

    (other,) = overall(opposite).agreement
    assert other.tau == pytest.approx(-1.0)
    assert other.violation == pytest.approx(np.mean([12, 9, 6, 9, 12]) / SEEDS)


def test_axes_without_an_effect_have_no_order():
    (found,) = overall(lambda cell: SEEDS).agreement
    assert (found.tau, found.violation) == (None, 0.0)


def test_the_orders_of_few_axes_are_not_compared():
    plan = cells(("oracle", "experts"), TASKS, [CLEAN, *LEVELS[:4]])
    assert overall(by_axis, plan).agreement == ()


def test_a_level_that_the_gate_caps_in_every_task_does_not_count():
    run = document(SEEDS, PLAN, oracle_gate="oracle")
    rows = played(by_axis)
    rows.loc[(rows["policy"] == "oracle") & (rows["axis"] == "table") & (rows["severity"] == 4), "status"] = "failure"
    assert of(build_robustness_summary(run, select_eligible(run, rows))).conditions == 9


def test_a_run_without_axes_or_rows_has_no_summary():
    plan = cells(("oracle", "experts"), TASKS, [CLEAN, Condition("blind", 1)])
    assert overall(lambda cell: SEEDS, plan) is None
    run = document(SEEDS, PLAN, oracle_gate="oracle")
    assert build_robustness_summary(run, select_eligible(run, played(by_axis).iloc[:0])) is None


def test_tables_and_findings_say_what_was_shown_and_what_was_not():
    found = overall(by_axis)
    line = summary_table(found).rows[0]
    assert line[:2] == ("experts", "all")
    assert "camera-orbit" in line
    assert agreement_table(found).rows[0][:2] == ("experts", "maniskill, robosuite")
    assert agreement_findings(found)[0].startswith("experts: maniskill and robosuite (tau 1.00")
    nothing = agreement_findings(overall(lambda cell: SEEDS))
    assert nothing == ["experts: agreement on the order of axes was not shown between maniskill and robosuite."]


def test_agreement_of_unrelated_orders_is_found_in_one_run_of_twenty_at_most():
    generator = np.random.default_rng(3)
    found = [kendall(*generator.random((2, 9)))[1] for _ in range(1000)]
    assert np.mean(np.array(found) <= 0.05) == pytest.approx(0.05, abs=0.02)
