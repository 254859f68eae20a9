"""A routing study as tables and as JSON."""

import json
from dataclasses import replace
from math import log

import pytest

from robogauntlet.results.analysis.routing import Detection, Rate
from robogauntlet.suites.episode import View
from robogauntlet_mergevla.routing.contract import answer
from robogauntlet_mergevla.routing.evaluation import RoutedObservation
from robogauntlet_mergevla.routing_evaluation.evaluation import (
    RouterResult,
    RoutingStudy,
    RoutingStudyRequest,
    UnknownResult,
    quality_of,
)
from robogauntlet_mergevla.routing_evaluation.tables import as_json, confusions, router_table, split, unknown_table

PUSH, PICK, LIFT = "pybullet/PandaPush-v3", "pybullet/PandaPickAndPlace-v3", "robosuite/Lift"
TASKS = (PICK, PUSH, LIFT)


def trial(task, chosen):
    routing = answer({name: log(0.8 if name == chosen else 0.1) for name in TASKS})
    return RoutedObservation(task, replace(routing, latency_s=0.02))


@pytest.fixture
def study():
    trials = [trial(task, task) for task in TASKS for _ in range(9)]
    trials += [trial(PICK, PUSH), trial(PUSH, LIFT), trial(PUSH, LIFT)]
    routers = (RouterResult("calibrated", False, 1, quality_of(trials), 2.0),)
    by_task = {
        PUSH: Detection(20, 10, 0.9, 0.25, Rate.from_counts(5, 10), Rate.from_counts(1, 20)),
        LIFT: Detection(20, 10, 0.8, 0.15, Rate.from_counts(7, 10), Rate.from_counts(3, 20)),
    }
    unknown = (UnknownResult("calibrated", False, by_task),)
    request = RoutingStudyRequest("merged", range(5, 15))
    return RoutingStudy(request, "digest", View(), TASKS, {}, False, 0.01, routers, unknown)


def test_a_router_is_a_row_and_tasks_that_share_a_scene_have_a_column(study):
    table = router_table(study)
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


def test_a_wide_table_is_split(study):
    table = router_table(study)
    without, alone = split(table, 1)
    assert without.header == ("router", "instruction", "accuracy", "ECE", "Brier", "passes", "latency", "in\npasses")
    assert alone.rows == (("calibrated", "hidden", "86 % [65, 95]"),)
    assert {len(row) for row in without.rows} == {len(without.header)}


def test_confusions_are_the_wrong_choices_most_frequent_first(study):
    assert confusions(study.routers[0].quality.confusion) == [f"{PUSH} -> {LIFT}: 2", f"{PICK} -> {PUSH}: 1"]


def test_each_unknown_task_and_their_mean_are_rows(study):
    assert unknown_table(study.unknown[0]).rows == (
        (PUSH, "0.900", "25 %", "50 %", "5 %"),
        (LIFT, "0.800", "15 %", "70 %", "15 %"),
        ("mean", "0.850", "20 %", "60 %", "10 %"),
    )


def test_the_study_is_valid_json(study):
    written = json.loads(json.dumps(as_json(study), allow_nan=False))
    assert written["seeds"] == {"start": 5, "count": 10}
    (router,) = written["routers"]
    assert router["quality"]["accuracy"]["successes"] == 27
    assert router["quality"]["confusion"]["inferred"] == [PICK, PUSH, LIFT]
    assert router["quality"]["confusion"]["counts"] == [[9, 1, 0], [0, 9, 2], [0, 0, 9]]
    assert router["quality"]["scene_pairs"][0]["tasks"] == [PUSH, PICK]
    assert written["unknown_tasks"][0]["by_task"][PUSH]["auroc"] == 0.9
