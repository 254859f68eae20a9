"""What grows with severity."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import t

from robogauntlet.results.statistics.pairs import Pairs, paired_difference
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.results.statistics.severity import area, falling_trend, half_lost, retention, severity_curve

LEVELS = np.arange(6.0)
kept = st.lists(st.floats(0, 1.5), min_size=6, max_size=6).map(np.array)


def generator():
    return np.random.default_rng(0)


def outcomes(rates, seeds=100):
    """One stratum with these rates, the same seeds failing first at every level."""
    return np.array([[seed < round(rate * seeds) for rate in rates] for seed in range(seeds)], dtype=float)


def test_a_curve_has_known_values():
    found = severity_curve([outcomes((0.8, 0.8, 0.6, 0.4, 0.2, 0.0))], LEVELS)
    assert [rate.value for rate in found.rates] == pytest.approx([0.8, 0.8, 0.6, 0.4, 0.2, 0.0])
    assert [drop.value for drop in found.drops] == pytest.approx([0, 0, 0.2, 0.4, 0.6, 0.8])
    assert list(found.retention) == pytest.approx([1, 1, 0.75, 0.5, 0.25, 0])
    assert found.area.value == pytest.approx((0.5 + 1 + 0.75 + 0.5 + 0.25 + 0) / 5)
    assert found.half == pytest.approx(3)
    assert found.trend < 1e-6
    assert all(drop.interval.low <= drop.value <= drop.interval.high for drop in found.drops[1:])


def test_a_few_seeds_that_all_succeed_are_not_certain():
    found = severity_curve([outcomes((1.0, 1.0, 1.0), 6)], [0, 2, 4])
    assert found.rates[0].interval == wilson_interval(6, 6)
    assert found.drops[2].interval.low < -0.2
    assert found.drops[2].interval.high > 0.2
    assert found.area.interval is None


def test_rates_have_the_interval_of_all_seeds_and_drops_that_of_pairs():
    strata = [outcomes((0.8, 0.4), 10), outcomes((0.6, 0.2), 10)]
    found = severity_curve(strata, [0, 1])
    assert found.rates[0].interval == wilson_interval(14, 20)
    assert found.drops[1] == paired_difference(Pairs(6, 8, 0, 6))


def test_baselines_are_subtracted_before_anything_is_divided():
    found = severity_curve([outcomes((0.9, 0.5, 0.1))], [0, 2, 4], baselines=[0.1, 0.1, 0.1])
    assert list(found.retention) == pytest.approx([1, 0.5, 0])


def test_strata_count_alike_whatever_their_size_and_the_interval_is_that_of_their_mean():
    """The mean of rates of 10 and 90 seeds varies as that of 36."""
    found = severity_curve([outcomes((1.0, 0.0), 10), outcomes((1.0, 1.0), 90)], [0, 1]).rates[1]
    assert found.value == pytest.approx(0.5)
    assert found.interval == wilson_interval(18, 36)


def test_the_area_has_the_interval_of_the_seeds_that_differ():
    """Of 20 seeds 4 fail at the last level: 0.8 is kept, with a standard error of sqrt(0.16 / 19)."""
    found = severity_curve([outcomes((1.0, 0.8), 20)], [0, 2])
    half = t.isf(0.025, 19) * math.sqrt(0.8 * 0.2 / 19) / 2
    ends = found.area.interval
    assert (found.area.value, ends.low, ends.high) == pytest.approx((0.9, 0.9 - half, 0.9 + half))


def test_kinds_of_change_have_rates_and_drops_but_no_trend_area_or_half():
    found = severity_curve([outcomes((0.9, 0.6, 0.1))], [0, 2, 4], ordered=False)
    assert (found.trend, found.area, found.half) == (None, None, None)


def test_a_policy_that_is_not_shown_to_do_anything_clean_has_nothing_to_retain():
    found = severity_curve([outcomes((0.25, 0.1), 20)], [0, 1])
    assert found.retention is found.area is found.half is None
    assert found.drops[1].value == pytest.approx(0.15)


def test_half_that_is_never_lost_is_beyond_the_last_level():
    found = severity_curve([outcomes((0.9, 0.9, 0.8))], [0, 2, 4])
    assert found.half == math.inf


def test_half_lost_has_known_values():
    assert half_lost(np.array([1, 0.6, 0.2]), np.array([0.0, 2, 4])) == pytest.approx(2.5)
    assert half_lost(np.array([1, 0.4, 0.8, 0.0]), np.array([0.0, 1, 2, 3])) == pytest.approx(2 + 0.1 / 0.6)
    assert half_lost(np.array([1, 0.9]), np.array([0.0, 1])) == math.inf
    assert math.isnan(half_lost(np.array([1, np.nan]), np.array([0.0, 1])))


@given(kept)
def test_half_is_lost_within_the_levels_or_beyond(found):
    severity = half_lost(found, LEVELS)
    assert severity == math.inf or 0 <= severity <= 5


@given(kept)
def test_the_area_is_one_if_everything_is_kept_and_grows_with_retention(found):
    assert area(np.ones(6), LEVELS) == pytest.approx(1)
    assert area(found, LEVELS) <= area(np.maximum(found, 1), LEVELS) + 1e-12


def test_retention_without_anything_to_retain_is_no_number():
    assert np.isnan(retention(np.array([[0.1, 0.1]]), np.array([0.1, 0.0]))[0]).all()


def test_a_task_without_a_rate_at_a_level_is_left_out_of_its_clean_rate():
    easy, hard = outcomes((1.0, 1.0), 10), outcomes((0.5, 0.5), 10)
    easy[:, 1] = np.nan
    found = severity_curve([easy, hard], [0, 1])
    assert [rate.value for rate in found.rates] == pytest.approx([0.75, 0.5])
    assert found.retention[1] == pytest.approx(1.0)
    assert found.drops[1].value == pytest.approx(0.0)


def test_outcomes_without_verdict_are_left_out_of_their_level_alone():
    stratum = outcomes((1.0, 0.5), 10)
    stratum[0, 1] = np.nan
    found = severity_curve([stratum], [0, 1])
    assert found.rates[0].value == 1.0
    assert found.rates[1].value == pytest.approx(4 / 9)


def test_the_trend_has_known_values():
    # One seed that succeeds at level 0 of (0, 1) only: excess -1/2, variance 1/4.
    assert falling_trend([np.array([[1.0, 0.0]])], np.array([0.0, 1.0])) == pytest.approx(0.158655, abs=1e-6)
    assert falling_trend([np.array([[0.0, 1.0]])], np.array([0.0, 1.0])) == pytest.approx(0.841345, abs=1e-6)
    assert falling_trend([np.ones((5, 2)), np.zeros((5, 2))], np.array([0.0, 1.0])) is None


def test_a_trend_is_found_in_one_of_twenty_data_sets_that_do_not_fall():
    draw = generator()
    found = [falling_trend([(draw.random((40, 6)) < 0.6).astype(float)], LEVELS) for _ in range(2000)]
    assert np.mean(np.array(found) <= 0.05) == pytest.approx(0.05, abs=0.015)


@pytest.mark.parametrize(
    ("levels", "baselines", "message"),
    [
        ([1, 2], None, "expected levels that rise from 0"),
        ([0, 0], None, "expected levels that rise from 0"),
        ([0, 1, 2], None, r"expected outcomes of shape \(seeds, 3\)"),
        ([0, 1], [0.1], "expected a floor for each of 2 levels, got 1"),
    ],
)
def test_levels_baselines_and_outcomes_that_do_not_fit_are_refused(levels, baselines, message):
    with pytest.raises(ValueError, match=message):
        severity_curve([outcomes((1.0, 0.5), 10)], levels, baselines=baselines)
