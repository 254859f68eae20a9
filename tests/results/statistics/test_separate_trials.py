"""Tests of results/statistics/separate_trials.py."""

import pytest
from hypothesis import given, strategies as st
from scipy.stats import fisher_exact

from robogauntlet.results.statistics.separate_trials import Separate, fisher


@st.composite
def strata(draw, most=30):
    trials = draw(st.integers(1, most)), draw(st.integers(1, most))
    won = [draw(st.integers(0, count)) for count in trials]
    return Separate(won[0], trials[0], won[1], trials[1])


@given(strata())
def test_one_stratum_has_the_p_value_of_fishers_test(one):
    table = [[one.first, one.first_trials - one.first], [one.second, one.second_trials - one.second]]
    assert fisher([one]) == pytest.approx(fisher_exact(table)[1], abs=1e-9)


@given(st.lists(strata(5), min_size=1, max_size=3))
def test_sides_may_be_exchanged_and_a_stratum_without_information_changes_nothing(own):
    exchanged = [Separate(one.second, one.second_trials, one.first, one.first_trials) for one in own]
    assert fisher(own) == pytest.approx(fisher(exchanged))
    assert fisher([*own, Separate(3, 3, 5, 5)]) == pytest.approx(fisher(own))
    assert 0 <= fisher(own) <= 1


def test_a_difference_between_strata_is_none_between_sides():
    # Each side succeeds in 9 of 10 in one task and in 1 of 10 in the other; they play them unequally often.
    assert fisher([Separate(90, 100, 9, 10), Separate(1, 10, 10, 100)]) > 0.9
    assert fisher([Separate(91, 110, 19, 110)]) < 1e-9


def test_many_trials_are_no_trouble():
    assert fisher([Separate(50_000, 100_000, 50_000, 100_000)] * 3) == pytest.approx(1.0)
    assert fisher([Separate(100_000, 100_000, 0, 100_000)]) == 0.0
    assert fisher([]) == 1.0
