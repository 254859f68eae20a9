"""A study of routers as tables and as JSON."""

import json
from math import log

import pytest

from orchestrator.routing_study import Order, RoutingStudy
from orchestrator.routing_tables import as_json, confusions, router_table, scene_pairs, split, unknown_table
from policies.mergevla.routing.contract import answer
from policies.mergevla.routing.study import Detection, LeftOut, Trial, study
from policies.mergevla.routing.trials import Judged, Judgement, UnknownTasks
from suites.vocabulary import View

PUSH, PICK, LIFT = "pybullet/PandaPush-v3", "pybullet/PandaPickAndPlace-v3", "robosuite/Lift"
TASKS = (PICK, PUSH, LIFT)


def trial(task, chosen):
    return Trial(task, answer({name: log(0.8 if name == chosen else 0.1) for name in TASKS}), 0.02)


@pytest.fixture
def found():
    trials = [trial(task, task) for task in TASKS for _ in range(9)]
    trials += [trial(PICK, PUSH), trial(PUSH, LIFT), trial(PUSH, LIFT)]
    judged = Judged("calibrated", False, 1, study(trials), 2.0)
    detection = Detection(0.9, 0.25, 20, 10, 0.5, 0.05)
    left_out = LeftOut({PUSH: detection}, 0.9, 0.25, 0.5, 0.05)
    unknown = (UnknownTasks("calibrated", False, left_out),)
    order = Order("merged", range(5, 15))
    return RoutingStudy(order, "digest", View(), TASKS, {}, False, Judgement(0.01, (judged,)), unknown)


def test_a_router_is_a_line_and_tasks_that_share_a_scene_have_a_column(found):
    table = router_table(found)
    (row,) = table.rows
    assert dict(zip(table.header, row, strict=True)) == {
        "router": "calibrated",
        "instruction": "hidden",
        "accuracy": "90 % [74, 97]",
        "PandaPush,\nPandaPickAndPlace": "86 % [65, 95]",
        "ECE": "0.100",
        "Brier": "0.200",
        "passes": "1",
        "latency": "20 ms",
        "in\npasses": "2.00",
    }


def test_a_table_too_wide_is_split(found):
    table = router_table(found)
    without, alone = split(table, 1)
    assert without.header == ("router", "instruction", "accuracy", "ECE", "Brier", "passes", "latency", "in\npasses")
    assert alone.rows == (("calibrated", "hidden", "86 % [65, 95]"),)
    assert {len(row) for row in without.rows} == {len(without.header)}


def test_only_pairs_of_which_both_were_seen_have_a_column():
    assert scene_pairs([PUSH, LIFT]) == []
    assert scene_pairs(["maniskill/PullCube-v1", "maniskill/PushCube-v1"]) == [
        ("maniskill/PushCube-v1", "maniskill/PullCube-v1")
    ]


def test_confusions_are_the_wrong_choices_most_first(found):
    assert confusions(found.judgement.routers[0].study) == [f"{PUSH} -> {LIFT}: 2", f"{PICK} -> {PUSH}: 1"]


def test_an_unknown_task_is_a_line_and_so_is_their_mean(found):
    table = unknown_table(found.unknown[0].left_out)
    assert table.rows == tuple((name, "0.900", "25 %", "50 %", "5 %") for name in (PUSH, "mean"))


def test_all_of_it_is_json(found):
    written = json.loads(json.dumps(as_json(found), allow_nan=False))
    assert written["seeds"] == {"start": 5, "count": 10}
    (router,) = written["routers"]
    assert router["accuracy"]["successes"] == 27
    assert router["confusion"][PUSH] == {PICK: 0, PUSH: 9, LIFT: 2}
    assert router["scene_pairs"][0]["tasks"] == [PUSH, PICK]
    assert written["unknown_tasks"][0]["by_task"][PUSH]["auroc"] == 0.9
