"""Judging routers."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from policies.mergevla.routing.centroids import fit_centres
from policies.mergevla.routing.contract import Routed, RoutingError, answer
from policies.mergevla.routing.features import Reading
from policies.mergevla.routing.gaussian import fit
from policies.mergevla.routing.study import Count, Trial, detection, leave_one_out, study
from tests.policies.mergevla.routing.synthetic import gaussians

scores = st.lists(st.integers(-3, 3).map(float), min_size=1, max_size=30)


def trial(task, probabilities, **changes):
    return Trial(task, answer({name: float(np.log(p)) for name, p in probabilities.items()}), **changes)


def test_counts_and_confusion():
    trials = [trial("a", {"a": 0.9, "b": 0.1}), trial("a", {"a": 0.4, "b": 0.6}), trial("b", {"a": 0.2, "b": 0.8})]
    found = study(trials)
    assert found.total == Count(2, 3)
    assert found.by_task == {"a": Count(1, 2), "b": Count(1, 1)}
    assert found.confusion == {"a": {"a": 1, "b": 1}, "b": {"a": 0, "b": 1}}
    assert (found.rejected, found.latency) == (None, None)


def test_calibration_is_compared_bin_by_bin():
    trials = [trial("a", {"a": 0.8, "b": 0.2})] * 3 + [trial("b", {"a": 0.8, "b": 0.2})]
    found = study(trials).calibrated
    assert found.expected_error == pytest.approx(0.05)
    assert found.brier == pytest.approx((3 * 2 * 0.2**2 + 2 * 0.8**2) / 4)
    sure = study([trial("a", {"a": 1.0 - 1e-12, "b": 1e-12})]).calibrated
    assert sure.expected_error == pytest.approx(0.0, abs=1e-9)


def test_scores_that_are_no_probabilities_have_no_calibration():
    assert study([Trial("a", Routed({"a": 3.0, "b": 2.0}, "a"))]).calibrated is None


def test_latency_and_rejections_are_summed_up():
    trials = [Trial("a", Routed({"a": 0.0}, "a", 1.0, i > 7), i / 10) for i in range(11)]
    found = study(trials)
    assert found.rejected == 3
    assert (found.latency.median_s, found.latency.longest_s) == (0.5, 1.0)
    assert found.latency.p95_s == pytest.approx(0.95)


def test_what_cannot_be_judged_is_refused():
    with pytest.raises(RoutingError, match="expected routed episodes, got none"):
        study([])
    with pytest.raises(RoutingError, match="have an expert, got one of 'c'"):
        study([trial("c", {"a": 0.9, "b": 0.1})])
    with pytest.raises(RoutingError, match="expected scores over a, b, got a"):
        study([trial("a", {"a": 0.9, "b": 0.1}), trial("a", {"a": 1.0})])
    with pytest.raises(RoutingError, match="got 0 and 1"):
        detection([], [1.0])
    with pytest.raises(RoutingError, match="expected finite scores"):
        detection([np.nan], [1.0])


@given(scores, scores)
def test_auroc_is_the_share_of_ordered_pairs(known, unknown):
    pairs = [(u > k) + 0.5 * (u == k) for u in unknown for k in known]
    assert detection(known, unknown).auroc == pytest.approx(np.mean(pairs))


@given(scores, scores)
def test_the_false_positive_rate_is_at_the_highest_threshold_that_finds_enough(known, unknown):
    enough = [t for t in unknown if np.mean([u >= t for u in unknown]) >= 0.95]
    expected = np.mean([k >= max(enough) for k in known])
    assert detection(known, unknown).false_positive_rate == pytest.approx(expected)


@pytest.mark.parametrize("fitted", [partial(fit, reading=Reading()), partial(fit_centres, reading=Reading())])
def test_a_left_out_task_is_noticed_if_it_is_apart(fitted):
    found = leave_one_out(fitted, gaussians(0), gaussians(1))
    assert found.by_task.keys() == {"a", "b", "c", "d"}
    assert found.auroc > 0.99
    assert found.false_positive_rate < 0.05
    assert {(one.known, one.unknown) for one in found.by_task.values()} == {(120, 80)}


def test_a_left_out_task_that_looks_like_another_is_not_noticed():
    near = gaussians(0, apart=0.0), gaussians(1, apart=0.0)
    assert 0.4 < leave_one_out(partial(fit, reading=Reading()), *near).auroc < 0.6


@pytest.mark.parametrize("fitted", [partial(fit, reading=Reading()), partial(fit_centres, reading=Reading())])
def test_a_left_out_task_is_judged_by_other_sightings(fitted):
    found = leave_one_out(fitted, gaussians(0), gaussians(1), gaussians(2, count=100, classes=("a", "b", "c")))
    assert found.by_task.keys() == {"a", "b", "c"}
    assert {(one.known, one.unknown) for one in found.by_task.values()} == {(200, 100)}
    assert found.rejected > 0.95
    assert 0.0 < found.false_alarms < 0.15


def test_the_share_rejected_is_beyond_the_threshold():
    found = detection([0.0, 1.0, 2.0, 3.0], [2.0, 3.0], threshold=2.0)
    assert (found.rejected, found.false_alarms) == (0.5, 0.25)
    assert detection([0.0], [1.0]).rejected is None


def test_leaving_out_takes_two_experts():
    alone = gaussians(0, classes=("a",))
    with pytest.raises(RoutingError, match="expected two experts or more, got a"):
        leave_one_out(partial(fit, reading=Reading()), alone, alone)
