"""Evidence that may be looked at after every pair."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from results.statistics.pairs import Pairs
from results.statistics.sequential import (
    anytime_difference,
    anytime_mean,
    is_decided,
    log_evidence,
    paired_evidence,
)

count = st.integers(0, 500)


def evidence(first_only, second_only):
    return paired_evidence(Pairs(0, first_only, second_only, 0))


def test_by_hand():
    assert evidence(0, 0) == pytest.approx(1.0)
    assert evidence(1, 0) == pytest.approx(1.0)  # one pair tells nothing about a fair coin
    assert evidence(2, 0) == pytest.approx(4 * (math.gamma(2.5) * math.gamma(0.5) / math.gamma(3)) / math.pi)
    assert evidence(2, 0) == pytest.approx(1.5)


@given(count, count)
def test_under_equal_rates_the_next_pair_changes_nothing_on_average(x, y):
    now, first, second = log_evidence(np.array([x, x + 1, x]), np.array([y, y, y + 1]))
    assert math.log((math.exp(first - now) + math.exp(second - now)) / 2) == pytest.approx(0.0, abs=1e-8)


@given(count, count)
def test_exchanging_the_sides_changes_nothing(x, y):
    assert evidence(x, y) == pytest.approx(evidence(y, x))


def test_pairs_that_agree_are_no_evidence():
    assert paired_evidence(Pairs(90, 3, 1, 40)) == paired_evidence(Pairs(0, 3, 1, 0))


def test_overwhelming_evidence_is_infinite_and_does_not_overflow():
    assert evidence(5000, 0) == math.inf
    assert is_decided(Pairs(0, 5000, 0, 0))


def test_decided_is_evidence_of_one_over_alpha():
    assert evidence(7, 0) > 20 > evidence(6, 0)
    assert is_decided(Pairs(0, 7, 0, 0))
    assert not is_decided(Pairs(0, 6, 0, 0))
    assert not is_decided(Pairs(0, 7, 0, 0), alpha=0.01)
    with pytest.raises(ValueError, match="expected an alpha between 0 and 1"):
        is_decided(Pairs(0, 1, 0, 0), alpha=0.0)


def test_looking_after_every_pair_decides_wrongly_in_at_most_one_run_of_twenty():
    generator = np.random.default_rng(0)
    runs, pairs = 2000, 400
    outcome = generator.choice([0, 1, 2], p=[0.75, 0.125, 0.125], size=(runs, pairs))
    first, second = (outcome == 1).cumsum(axis=1), (outcome == 2).cumsum(axis=1)
    wrong = (log_evidence(first, second) >= -math.log(0.05)).any(axis=1).mean()
    assert wrong < 0.05


@pytest.mark.parametrize("mean", [0.1, 0.5, 0.93])
def test_the_interval_covers_the_mean_at_every_moment(mean):
    generator = np.random.default_rng(1)
    missed = 0
    for _ in range(60):
        values = (generator.random(150) < mean).astype(float)
        found = anytime_mean(values)  # the intersection of all moments
        missed += not found.low <= mean <= found.high
    assert missed <= 6  # 3 expected at most; 7 or more have a probability of 3 %


@settings(max_examples=20)
@given(st.lists(st.floats(0, 1), max_size=40))
def test_more_values_never_widen_the_interval(values):
    before, after = anytime_mean(values[:-1]), anytime_mean(values)
    assert before.low <= after.low + 2e-3
    assert after.high <= before.high + 2e-3


def test_the_interval_narrows_around_the_mean():
    found = anytime_mean([1.0, 0.0, 1.0, 1.0] * 200)
    assert found.low < 0.75 < found.high
    assert found.high - found.low < 0.15


def test_seen_from_the_other_side_the_interval_is_the_mirrored_one():
    values = [1, 0, 1, 1, 1, 0, 1, 1, 1, 1]
    there, back = anytime_mean(values), anytime_mean([1 - value for value in values])
    assert (there.low, there.high) == pytest.approx((1 - back.high, 1 - back.low))


def test_a_difference_that_cannot_be_missed_is_found():
    found = anytime_difference([1, 0, 1, 1, 0] * 40)
    assert 0.3 < found.low < 0.6 < found.high <= 1
    assert anytime_difference([]) == anytime_difference([])
    assert (anytime_difference([]).low, anytime_difference([]).high) == (-1.0, 1.0)


def test_values_outside_the_unit_interval_are_refused():
    with pytest.raises(ValueError, match="expected values between 0 and 1"):
        anytime_mean([0.5, 1.5])
    with pytest.raises(ValueError, match="expected a confidence"):
        anytime_mean([0.5], confidence=1.0)
