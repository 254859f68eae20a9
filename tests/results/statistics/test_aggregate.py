"""Aggregates over cells."""

import numpy as np
import pytest
from scipy.stats import t

from robogauntlet.results.statistics.aggregate import mean_of_levels, mean_outcomes


def test_means_leave_out_what_has_no_verdict():
    strata = [np.array([[1.0, 0.0], [np.nan, 1.0], [0.0, 1.0]])]
    assert mean_outcomes(strata)[0] == pytest.approx([0.5, 2 / 3])


def test_the_mean_of_levels_of_one_stratum_has_student_s_interval():
    outcomes = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 0.0], [1.0, 0.0]])
    found = mean_of_levels([outcomes], 0.9)
    own = outcomes.mean(axis=1)
    ends = t.interval(0.9, 3, loc=own.mean(), scale=own.std(ddof=1) / 2)
    assert found.value == pytest.approx(0.5)
    assert (found.interval.low, found.interval.high) == pytest.approx(ends)


def test_a_stratum_whose_trials_differ_alone_has_its_own_degrees_of_freedom():
    alike, own = np.zeros((4, 1)), np.array([[1.0], [0.0], [0.0], [0.0]])
    found = mean_of_levels([alike, own, alike], 0.9)
    ends = t.interval(0.9, 3, loc=1 / 12, scale=own.std(ddof=1) / 2 / 3)
    assert (found.interval.low, found.interval.high) == pytest.approx(ends)


def test_levels_and_strata_have_equal_weight_and_trials_without_a_number_none():
    first = np.array([[1.0, np.nan], [0.0, np.nan], [np.nan, np.nan]])
    second = np.array([[0.0, 1.0], [0.0, 1.0]])
    found = mean_of_levels([first, second, np.full((3, 2), np.nan)])
    assert found.value == pytest.approx((0.25 + 1.0) / 2)
    assert found == mean_of_levels([first[:2], second])


def test_trials_that_are_alike_or_alone_have_no_interval():
    assert mean_of_levels([np.ones((4, 2))]).interval is None
    assert mean_of_levels([np.array([[1.0], [0.0]]), np.array([[1.0]])]).interval is None
    assert mean_of_levels([np.full((2, 1), np.nan)]) is None
