"""How success falls with severity, and what was delivered, from rows."""

import dataclasses

import pandas as pd
import pytest

from results.robustness import COLUMNS, build_robustness, is_perturbed
from suites.vocabulary import Condition
from tests.results.synthetic import cells, document, row

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


def built(results=None, plan=PLAN):
    frame = pd.DataFrame([dataclasses.asdict(result) for result in (rows() if results is None else results)])
    return build_robustness(document(SEEDS, of=plan), frame[list(COLUMNS)])


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
    assert noise.curve.half.value == pytest.approx(2.0)
    assert (noise.tasks, noise.seeds) == (2, SEEDS)
    assert curve(found, "merged", None, "blur").curve.levels == (0, 4)


def test_errors_are_left_out_of_their_level():
    results = [
        row(dataclasses.replace(PLAN[0]), r.seed, "error") if r.policy == "expert" and r.seed == 0 and i == 0 else r
        for i, r in enumerate(rows())
    ]
    found = curve(built(results), "expert", "maniskill", "noise")
    assert found.curve.rates[0].value == 1.0
    assert found.seeds == SEEDS


def test_what_was_delivered_is_compared_across_simulators():
    noise = {(r.axis, r.severity): r for r in built().delivered}["noise", 4]
    assert (noise.asked, noise.unit) == (18.4, "dB PSNR")
    assert [(c.simulator, c.episodes) for c in noise.simulators] == [("maniskill", 40), ("pybullet", 40)]
    assert noise.spread == pytest.approx(0.02)


def test_perturbed_episodes_that_start_elsewhere_than_the_clean_ones_are_counted():
    assert built().worlds.differing == 0
    assert built().worlds.compared == 2 * 2 * 3 * SEEDS
    moved = [dataclasses.replace(r, state_hash="elsewhere") if r.axis == "blur" else r for r in rows()]
    assert built(moved).worlds.differing == 2 * 2 * SEEDS


def test_without_clean_episodes_there_is_no_curve():
    plan = cells(("expert",), TASKS, CONDITIONS[1:])
    found = built([r for r in rows() if r.axis != "clean" and r.policy == "expert"], plan)
    assert found.curves == ()
    assert found.delivered
    assert found.worlds.compared == 0


def test_without_rows_there_is_nothing():
    empty = pd.DataFrame([dataclasses.asdict(rows()[0])])[:0]
    found = build_robustness(document(SEEDS, of=PLAN), empty[list(COLUMNS)])
    assert found.curves == ()
    assert found.delivered == ()


def test_equal_rows_give_equal_intervals():
    assert built() == built()
