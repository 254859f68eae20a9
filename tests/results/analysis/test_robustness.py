"""Success by severity, and delivered values, from rows."""

import dataclasses
import math

import pytest

from robogauntlet.results.analysis.robustness import StartStates, is_perturbed
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, robustness_of, row, rows_where

CONDITIONS = (Condition(), Condition("noise", 2), Condition("noise", 4), Condition("blur", 4))
TASKS = ("maniskill/PushCube-v1", "pybullet/PandaPush-v3")
PLAN = cells(("expert", "merged"), TASKS, CONDITIONS)
SEEDS = 20
WON = {("expert", 0): 20, ("expert", 2): 16, ("expert", 4): 10, ("merged", 0): 16, ("merged", 2): 8, ("merged", 4): 0}
DELIVERED = {"maniskill": 0.99, "pybullet": 1.01}


def rows(**changes):
    found = []
    for cell in PLAN:
        severity = cell.condition.severity
        for seed in range(SEEDS):
            delivered = {2: 28.0, 4: 18.4}[severity] * DELIVERED[cell.simulator] if severity else None
            status = "success" if seed < WON[cell.policy, severity] else "failure"
            found.append(row(cell, seed, status, delivered=delivered, **changes))
    return found


def built(results=None, plan=PLAN, **changes):
    return robustness_of(document(SEEDS, of=plan, **changes), rows() if results is None else results)


def curve(robustness, policy, simulator, axis):
    wanted = (policy, simulator, axis)
    return next(found for found in robustness.curves if (found.policy, found.simulator, found.axis) == wanted)


def test_a_run_is_perturbed_if_anything_but_clean_is_planned():
    assert is_perturbed(document(of=PLAN))
    assert not is_perturbed(document())


def test_each_policy_has_a_curve_per_axis_over_all_simulators_and_in_each():
    found = built()
    assert found.axes == ("noise", "blur")
    assert [(c.policy, c.simulator) for c in found.curves if c.axis == "blur"] == [
        *(("expert", None), ("expert", "maniskill"), ("expert", "pybullet")),
        *(("merged", None), ("merged", "maniskill"), ("merged", "pybullet")),
    ]


def test_the_clean_episodes_are_level_0_of_every_axis():
    found = built()
    noise = curve(found, "merged", None, "noise")
    assert noise.curve.levels == (0, 2, 4)
    assert [rate.value for rate in noise.curve.rates] == pytest.approx([0.8, 0.4, 0.0])
    assert noise.curve.half == pytest.approx(2.0)
    assert (noise.tasks, noise.seeds) == (2, SEEDS)
    assert curve(found, "merged", None, "blur").curve.levels == (0, 4)


def test_errors_are_left_out_of_their_level():
    found = curve(built([row(PLAN[0], 0, "error"), *rows()[1:]]), "expert", "maniskill", "noise")
    assert found.curve.rates[0].value == 1.0
    assert found.seeds == SEEDS


def test_an_episode_in_which_the_axis_delivered_nothing_counts_in_no_rate():
    plan = cells(("expert",), TASKS[:1], (Condition(), Condition("frozen-frames", 2)))
    frozen = [row(plan[1], seed, "failure" if seed else "success", delivered=9.0 * (seed > 0)) for seed in range(4)]
    found = built([*(row(plan[0], seed, "success") for seed in range(4)), *frozen], plan)
    assert found.curves[0].episodes == (4, 3)
    assert found.curves[0].curve.rates[1].value == 0.0
    assert [cell.undelivered for cell in found.delivered[0].simulators] == [1]


GATED = cells(("expert", "oracle"), TASKS[:1], (Condition(), Condition("noise", 2), Condition("noise", 4)))


def gated(unsolved):
    """The oracle fails on these (severity, seed); the expert always succeeds but for seed 1 at severity 4."""
    failed = {"oracle": unsolved, "expert": {(4, 1)}}
    results = rows_where(lambda cell, seed: (cell.condition.severity, seed) not in failed[cell.policy], GATED, SEEDS)
    return built(results, GATED, oracle_gate="oracle")


def test_a_seed_that_the_gate_does_not_solve_counts_at_no_level():
    assert [rate.value for rate in gated(set()).curves[0].curve.rates] == pytest.approx([1, 1, 0.95])
    found = gated({(4, 1)})
    assert [rate.value for rate in found.curves[0].curve.rates] == [1.0, 1.0, 1.0]
    assert found.curves[0].seeds == SEEDS - 1
    assert [(g.axis, g.severity, g.passed, g.capped) for g in found.gate_rows] == [("noise", 4, SEEDS - 1, False)]


def test_a_level_at_which_the_gate_solves_too_little_is_capped_and_rejects_no_seed():
    found = gated({(4, 0), (4, 1), (4, 2)})
    curve = found.curves[0].curve
    assert [rate.value for rate in curve.rates[:2]] == [1.0, 1.0]
    assert math.isnan(curve.rates[2].value)
    assert found.curves[0].seeds == SEEDS
    assert found.gate_rows[0].capped


def test_the_gate_itself_has_no_curve():
    assert {c.policy for c in gated(set()).curves} == {"expert"}


def test_controls_are_no_axes_and_are_set_beside_the_clean_episodes():
    plan = cells(("expert",), TASKS, (Condition(), Condition("blind", 1)))
    found = built(rows_where(lambda cell, seed: seed < (10, 4)[cell.condition.severity], plan, 10), plan)
    assert found.axes == ()
    assert found.curves == ()
    whole = found.controls[0]
    assert (whole.policy, whole.simulator, whole.control) == ("expert", None, "blind")
    assert (whole.clean.value, whole.rate.value, whole.drop.value) == pytest.approx((1.0, 0.4, 0.6))


def test_delivered_values_are_compared_across_simulators():
    noise = {(r.axis, r.severity): r for r in built().delivered}["noise", 4]
    assert (noise.asked, noise.unit) == (18.4, "dB PSNR")
    assert [(c.simulator, c.episodes) for c in noise.simulators] == [("maniskill", 40), ("pybullet", 40)]
    assert noise.spread == pytest.approx(0.02)


def test_perturbed_episodes_with_another_start_state_are_counted():
    assert built().start_states.differing == 0
    assert built().start_states.compared == 2 * 2 * 3 * SEEDS
    moved = [dataclasses.replace(r, state_hash="other") if r.axis == "blur" else r for r in rows()]
    assert built(moved).start_states.differing == 2 * 2 * SEEDS


def test_axes_that_move_something_are_not_expected_to_start_from_the_clean_state():
    plan = cells(("expert",), TASKS, (Condition(), Condition("object-position", 2), Condition("dynamics", 2)))
    results = [row(cell, seed, "success", state_hash=cell.condition.axis) for cell in plan for seed in range(3)]
    assert built(results, plan).start_states == StartStates(compared=6, differing=6)


def test_without_clean_episodes_there_is_no_curve():
    plan = cells(("expert",), TASKS, CONDITIONS[1:])
    found = built([r for r in rows() if r.axis != "clean" and r.policy == "expert"], plan)
    assert found.curves == ()
    assert found.delivered
    assert found.start_states.compared == 0


def test_without_rows_there_are_no_curves():
    found = built([])
    assert found.curves == ()
    assert found.delivered == ()
