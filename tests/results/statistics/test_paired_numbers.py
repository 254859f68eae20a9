"""Median of paired differences and the signed-rank test."""

import numpy as np
import pytest
from scipy.stats import wilcoxon

from robogauntlet.results.statistics.paired_numbers import can_reject_symmetry, median_difference, signed_rank
from robogauntlet.results.statistics.rates import Estimate


@pytest.mark.parametrize("trials", [6, 9, 30])
def test_the_interval_of_a_median_covers_it_at_least_as_often_as_it_says(trials):
    draws = np.random.default_rng(7).exponential(size=(400, trials))
    found = [median_difference(one).interval for one in draws]
    assert np.mean([ends.low <= np.log(2) <= ends.high for ends in found]) >= 0.94


def test_too_few_trials_have_a_median_without_an_interval():
    assert median_difference(np.array([1.0, 2.0, 4.0, 8.0, 16.0])) == Estimate(4.0, None)


def test_the_signed_rank_test_leaves_zeros_out():
    values = np.array([0.0, 1.0, 2.0, -0.5, 3.0, 4.0, 5.0, 0.0])
    assert signed_rank(values) == pytest.approx(wilcoxon(values[values != 0]).pvalue)
    assert signed_rank(np.zeros(5)) == 1.0


@pytest.mark.parametrize("count", [0, 1, 5, 6, 20])
def test_a_test_is_possible_if_its_smallest_p_value_is_at_most_alpha(count):
    values = np.concatenate([np.arange(1, count + 1), np.zeros(3)])
    assert can_reject_symmetry(values, 0.05) == (signed_rank(values) <= 0.05)
