"""Evidence that may be evaluated after every pair."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from robogauntlet.results.statistics.pairs import Pairs
from robogauntlet.results.statistics.sequential import is_decided, log_evidence, paired_evidence

count = st.integers(0, 500)


def evidence(first_only, second_only):
    return paired_evidence(Pairs(0, first_only, second_only, 0))


def test_evidence_has_known_values():
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


def test_testing_after_every_pair_is_wrong_in_at_most_one_run_of_twenty():
    generator = np.random.default_rng(0)
    runs, pairs = 2000, 400
    outcome = generator.choice([0, 1, 2], p=[0.75, 0.125, 0.125], size=(runs, pairs))
    first, second = (outcome == 1).cumsum(axis=1), (outcome == 2).cumsum(axis=1)
    wrong = (log_evidence(first, second) >= -math.log(0.05)).any(axis=1).mean()
    assert wrong < 0.05
