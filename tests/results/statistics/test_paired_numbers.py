"""Median of paired differences and the signed-rank test."""

import numpy as np
import pytest
from scipy.stats import wilcoxon

from robogauntlet.results.statistics.paired_numbers import can_reject_symmetry, median_difference, signed_rank


def generator():
    return np.random.default_rng(7)


def test_the_interval_of_a_median_covers_it_about_as_often_as_it_says():
    draws, covered = generator(), 0
    for _ in range(300):
        found = median_difference(draws.normal(0.3, 1, 30), np.arange(30) % 2, draws, draws=200)
        covered += found.interval.low <= 0.3 <= found.interval.high
    assert 0.9 <= covered / 300 <= 0.99


def test_strata_are_not_mixed():
    """Each task differs by its own amount, without spread: drawing within tasks never changes the median."""
    found = median_difference(np.array([1.0, 1.0, 1.0, 5.0, 5.0]), np.array([0, 0, 0, 1, 1]), generator())
    assert (found.value, found.interval) == (1.0, None)


def test_many_differences_are_drawn_in_pieces(monkeypatch):
    values, strata = generator().normal(size=100), np.zeros(100, int)
    whole = median_difference(values, strata, generator())
    monkeypatch.setattr("robogauntlet.results.statistics.paired_numbers.AT_ONCE", 1000)
    assert median_difference(values, strata, generator()) == whole


def test_the_signed_rank_test_leaves_zeros_out():
    values = np.array([0.0, 1.0, 2.0, -0.5, 3.0, 4.0, 5.0, 0.0])
    assert signed_rank(values) == pytest.approx(wilcoxon(values[values != 0]).pvalue)
    assert signed_rank(np.zeros(5)) == 1.0


@pytest.mark.parametrize("count", [0, 1, 5, 6, 20])
def test_a_test_is_possible_if_its_smallest_p_value_is_at_most_alpha(count):
    values = np.concatenate([np.arange(1, count + 1), np.zeros(3)])
    assert can_reject_symmetry(values, 0.05) == (signed_rank(values) <= 0.05)
