"""Tests of results/analysis/routing.py."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st

from robogauntlet.results.analysis import routing
from robogauntlet.results.analysis.routing import calibration, detection, router_of
from robogauntlet.results.report.sections.routing import COLUMNS
from robogauntlet.results.statistics.rates import wilson_interval
from tests.results.routed import TASKS, evidence, plan
from tests.results.synthetic import columns_of, row

PUSH, PULL, PANDA, PICK, LIFT = TASKS


def frame(*inferred, **changes):
    """Rows of one routing policy: (true, inferred) each."""
    cells = {cell.task: cell for cell in plan(("merged",), (*TASKS, "robosuite/Door"))}
    results = [
        row(cells[true], seed, **({**evidence(chosen), **changes} if chosen else {}))
        for seed, (true, chosen) in enumerate(inferred)
    ]
    return columns_of(results, COLUMNS)


def test_accuracy_is_the_share_of_correctly_inferred_tasks():
    router = router_of(frame(*[(PUSH, PUSH)] * 3, (PUSH, PULL), *[(LIFT, LIFT)] * 4))
    assert (router.accuracy.rate, router.accuracy.interval) == (7 / 8, wilson_interval(7, 8))
    by_simulator = {name: (rate.successes, rate.trials) for name, rate in router.simulators}
    assert by_simulator == {"maniskill": (3, 4), "robosuite": (4, 4)}
    assert [(name, rate.rate) for name, rate in router.tasks] == [(PUSH, 0.75), (LIFT, 1.0)]


def test_episodes_without_an_inferred_task_are_left_out():
    assert router_of(frame((PUSH, None))) is None
    assert router_of(frame((PUSH, None), (PUSH, PUSH))).accuracy.trials == 1


def test_tasks_that_share_a_scene_are_shown_apart():
    router = router_of(frame((PANDA, PICK), (PICK, PICK), (PANDA, LIFT), (PUSH, PUSH), (LIFT, LIFT)))
    (pair,) = router.scene_pairs
    assert (pair.tasks, pair.accuracy.successes, pair.accuracy.trials, pair.mistaken) == ((PANDA, PICK), 1, 3, 1)


def test_a_confusion_of_many_tasks_has_the_most_mistaken(monkeypatch):
    monkeypatch.setattr(routing, "LARGEST_CONFUSION", 2)
    right = [(task, task) for task in TASKS]
    confusion = router_of(frame(*right, (PICK, PUSH), (LIFT, PULL), (LIFT, PUSH))).confusion
    assert confusion.true == (LIFT, PICK)
    assert dict(zip(confusion.inferred, confusion.counts[0], strict=True)) == {LIFT: 1, PICK: 0, PUSH: 1, PULL: 1}


def test_the_confusion_has_a_line_per_true_and_a_column_per_inferred_task():
    confusion = router_of(frame((PUSH, PUSH), (PUSH, PULL), (PULL, PULL), (PULL, LIFT))).confusion
    assert (confusion.true, confusion.inferred) == ((PUSH, PULL), (PUSH, PULL, LIFT))
    assert confusion.counts == ((1, 1, 0), (0, 1, 1))


def test_latency_is_reported_as_its_median_and_95th_percentile():
    rows = frame(*[(PUSH, PUSH)] * 101)
    rows["routing_s"] = np.arange(101) / 100
    latency = router_of(rows).latency
    assert (latency.median_s, latency.p95_s) == (0.5, 0.95)


def test_rejected_known_tasks_are_counted_only_if_the_router_can_reject():
    assert router_of(frame((PUSH, PUSH), rejected=None)).rejected is None
    assert router_of(frame((PUSH, PUSH), (PUSH, PUSH), rejected=True)).rejected.rate == 1


def test_an_unknown_task_is_in_no_accuracy_and_its_detection_is_measured():
    rows = frame((PUSH, PUSH), (PULL, PULL), ("robosuite/Door", PUSH), ("robosuite/Door", PULL))
    rows["unknown_score"] = [0.1, 0.4, 0.4, 0.9]
    router = router_of(rows)
    assert (router.accuracy.successes, router.accuracy.trials) == (2, 2)
    found = router.detection
    assert (found.known, found.unknown, found.auroc, found.false_positives) == (2, 2, 3.5 / 4, 0.5)
    assert (found.rejected.rate, found.false_alarms.rate) == (0, 0)
    assert "robosuite/Door" not in router.confusion.inferred


def test_a_router_as_accurate_as_its_confidence_has_no_calibration_error():
    half = {"a": math.log(0.5), "b": math.log(0.5)}
    found = calibration([half] * 4, ["a", "a", "b", "b"], ["a"] * 4)
    assert (found.expected_error, found.brier) == (0, 0.5)
    assert [(b.low, b.high, b.episodes, b.accuracy.rate) for b in found.bins] == [(7 / 15, 8 / 15, 4, 0.5)]


def test_confidence_and_accuracy_are_compared_bin_by_bin():
    low, high = ({"a": math.log(p), "b": math.log(1 - p)} for p in (0.6, 0.8))
    found = calibration([low] * 2 + [high] * 4, ["a", "b", "a", "a", "a", "b"], ["a"] * 6)
    assert found.expected_error == pytest.approx((2 * 0.1 + 4 * 0.05) / 6)


def test_a_certain_choice_is_in_the_last_bin():
    (last,) = calibration([{"a": 0.0, "b": -1e9}], ["a"], ["a"]).bins
    assert (last.low, last.high, last.confidence) == (14 / 15, 1, 1)


def test_overconfidence_is_the_distance_of_confidence_and_accuracy():
    sure = {"a": math.log(0.9), "b": math.log(0.1)}
    found = calibration([sure] * 2, ["a", "b"], ["a", "a"])
    assert found.expected_error == pytest.approx(0.4)
    assert found.brier == pytest.approx((0.02 + 1.62) / 2)


def test_scores_that_are_no_probabilities_have_no_calibration():
    assert calibration([{"a": 3.0, "b": 1e9}], ["a"], ["a"]) is None
    assert calibration([{}], ["a"], ["a"]) is None
    assert calibration([], [], []) is None


@given(st.lists(st.tuples(st.floats(0.01, 0.99), st.booleans()), min_size=1, max_size=50))
def test_calibration_stays_within_its_bounds(lines):
    scores = [{"a": math.log(p), "b": math.log(1 - p)} for p, _ in lines]
    true = ["a" if yes else "b" for _, yes in lines]
    found = calibration(scores, true, ["a"] * len(lines))
    assert 0 <= found.expected_error <= 1
    assert 0 <= found.brier <= 2
    assert sum(b.episodes for b in found.bins) == len(lines)
    assert all(b.low - 1e-9 <= b.confidence <= b.high + 1e-9 for b in found.bins)


def scored(scores, rejected=None):
    return pd.DataFrame({"unknown_score": scores, "rejected": rejected})


several = st.lists(st.integers(-3, 3).map(float), min_size=1, max_size=60)


@given(several, several)
def test_auroc_is_the_share_of_ordered_pairs(known, unknown):
    pairs = [(u > k) + 0.5 * (u == k) for u in unknown for k in known]
    assert detection(scored(known), scored(unknown)).auroc == pytest.approx(np.mean(pairs))


@given(several, several)
def test_false_positives_are_counted_at_the_highest_score_that_95_percent_of_the_unknown_reach(known, unknown):
    enough = [t for t in unknown if 100 * sum(u >= t for u in unknown) >= 95 * len(unknown)]
    expected = np.mean([k >= max(enough) for k in known])
    assert detection(scored(known), scored(unknown)).false_positives == pytest.approx(expected)


def test_rejections_and_false_alarms_are_shares_of_the_unknown_and_the_known():
    found = detection(scored([0.0, 1.0, 2.0, 3.0], [False, False, False, True]), scored([2.0, 3.0], [False, True]))
    assert (found.rejected.rate, found.false_alarms.rate) == (0.5, 0.25)
    without = detection(scored([0.0]), scored([1.0]))
    assert (without.rejected, without.false_alarms) == (None, None)


def test_without_scores_of_both_kinds_there_is_no_detection():
    assert detection(scored([0.0]), scored([])) is None
    assert detection(scored([None]), scored([1.0])) is None
