"""Aggregates over cells."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import t

from robogauntlet.results.statistics.aggregate import (
    interquartile_mean,
    mean_of_levels,
    mean_outcomes,
    percentile_interval,
    resampled_means,
    tail_mean,
)
from robogauntlet.results.statistics.rates import Estimate

values = st.lists(st.floats(0, 1), min_size=1, max_size=20).map(np.array)


def generator():
    return np.random.default_rng(0)


def estimate(strata, statistic=lambda means: means[:, 0], draws=2000):
    """A statistic of the strata's means, with its interval."""
    drawn = statistic(resampled_means(strata, generator(), draws)).reshape(draws)
    return Estimate(statistic(mean_outcomes(strata)[None]).item(), percentile_interval(drawn))


def test_the_interquartile_mean_has_known_values():
    assert interquartile_mean(np.array([0.0, 1, 2, 3, 4, 5, 6, 100])) == pytest.approx((2 + 3 + 4 + 5) / 4)
    assert interquartile_mean(np.array([1.0, 2, 6])) == pytest.approx(3)  # a quarter of three is none


def test_the_tail_mean_has_known_values():
    assert tail_mean(np.array([5.0, 1, 2, 4, 3])) == pytest.approx(1)
    assert tail_mean(np.array([5.0, 1, 2, 4, 3, 6])) == pytest.approx(1.5)  # 1.2 of six is two


@given(values)
def test_the_tail_mean_is_at_most_the_mean_and_both_lie_within_the_values(found):
    low, high = found.min() - 1e-12, found.max() + 1e-12
    assert low <= tail_mean(found) <= found.mean() + 1e-12
    assert low <= interquartile_mean(found) <= high


def test_means_leave_out_what_has_no_verdict():
    strata = [np.array([[1.0, 0.0], [np.nan, 1.0], [0.0, 1.0]])]
    assert mean_outcomes(strata)[0] == pytest.approx([0.5, 2 / 3])


def test_trials_are_resampled_as_pairs():
    first = generator().random((30, 1)) < 0.5
    strata = [np.concatenate([first, first], axis=1).astype(float)]
    drawn = resampled_means(strata, generator(), 200)
    assert drawn.shape == (200, 1, 2)
    assert (drawn[..., 0] == drawn[..., 1]).all()
    assert drawn[..., 0].std() > 0


def test_strata_are_fixed():
    strata = [np.zeros((5, 1)), np.ones((50, 1))]
    assert (resampled_means(strata, generator(), 20) == np.array([[0.0], [1.0]])).all()


def test_a_stratum_in_which_a_draw_has_no_verdict_gives_no_interval():
    strata = [np.array([[1.0], [np.nan]])]
    found = estimate(strata)
    assert found.value == 1.0
    assert found.interval is None


def test_the_interval_is_that_of_the_normal_approximation_where_it_holds():
    strata = [np.array([[1.0]] * 60 + [[0.0]] * 140)]
    found = estimate(strata, draws=8000)
    half = 1.96 * (0.3 * 0.7 / 200) ** 0.5
    assert found.value == pytest.approx(0.3)
    assert (found.interval.low, found.interval.high) == pytest.approx((0.3 - half, 0.3 + half), abs=0.006)


def test_pairing_narrows_the_interval_of_a_difference():
    first = (generator().random(200) < 0.5).astype(float)
    second = np.where(generator().random(200) < 0.05, 1 - first, first)
    paired = [np.stack([first, second], axis=1)]
    shuffled = [np.stack([first, np.random.default_rng(5).permutation(second)], axis=1)]
    widths = []
    for strata in (paired, shuffled):
        found = estimate(strata, lambda means: means[:, 0, 0] - means[:, 0, 1])
        widths.append(found.interval.high - found.interval.low)
    assert widths[0] < widths[1] / 2


def test_equal_generators_give_equal_draws():
    strata = [(generator().random((40, 3)) < 0.4).astype(float)]
    assert (resampled_means(strata, generator()) == resampled_means(strata, generator())).all()


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
