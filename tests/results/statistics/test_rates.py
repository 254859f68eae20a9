"""Success rates and their intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from robogauntlet.results.statistics.rates import (
    Interval,
    clustered_rate,
    rate,
    rate_bounds,
    rate_difference,
    wilson_interval,
    wilson_intervals,
)

counts = st.integers(1, 10_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))
small = st.integers(0, 500)


def test_a_rate_of_independent_trials_has_wilsons_interval():
    outcomes = np.array([1, 1, 0, 1, 0, 1, 1, 1, 0, 1] * 5)
    found = clustered_rate(outcomes, np.arange(50), np.zeros(50, int))
    assert found.value == pytest.approx(0.7)
    wilson = wilson_interval(35, 50)
    assert found.interval.low == pytest.approx(wilson.low, abs=0.006)
    assert found.interval.high == pytest.approx(wilson.high, abs=0.006)


@pytest.mark.parametrize(("points", "seeds", "spread"), [(84, 4, 2.0), (200, 4, 2.0), (20, 6, 1.0)])
def test_the_interval_covers_the_rate_over_all_start_states_where_few_seeds_differ(points, seeds, spread):
    generator = np.random.default_rng(0)
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    rate_over_seeds = float(weights @ (1 / (1 + np.exp(-spread * nodes))) / weights.sum())
    point, seed = (numbers.ravel() for numbers in np.indices((points, seeds)))
    covered = 0
    for _ in range(300):
        rates = 1 / (1 + np.exp(-spread * generator.normal(size=seeds)))
        found = clustered_rate((generator.random((points, seeds)) < rates).ravel().astype(float), point, seed)
        covered += found.interval.low <= rate_over_seeds <= found.interval.high
    assert covered / 300 > 0.9


@pytest.mark.parametrize(
    ("first", "second", "low", "high"),
    [((56, 70), (48, 80), 0.0524, 0.3339), ((9, 10), (3, 10), 0.1705, 0.8090), ((10, 10), (0, 10), 0.6075, 1.0)],
)
def test_the_difference_of_independent_rates_has_newcombes_interval(first, second, low, high):
    # G. Newcombe, Statistics in Medicine 17 (1998) 873-890, table II, cases a, b and h, method 10.
    found = rate_difference(first, second)
    assert found.value == pytest.approx(first[0] / first[1] - second[0] / second[1])
    assert (found.interval.low, found.interval.high) == pytest.approx((low, high), abs=6e-5)
    assert rate_difference(second, first).interval.low == pytest.approx(-high, abs=6e-5)


def test_without_trials_on_a_side_there_is_no_difference():
    assert rate_difference((0, 0), (3, 10)) is None
    assert rate_difference((3, 10), (0, 0)) is None


def test_trials_of_a_cluster_that_are_equal_count_once():
    outcomes = np.array([1, 1, 0, 1, 0, 1, 1, 1, 0, 1] * 5)
    found = clustered_rate(np.repeat(outcomes, 4), np.repeat(np.arange(50), 4), np.tile(range(4), 50))
    alone = wilson_interval(35, 50)
    assert found.interval.low == pytest.approx(alone.low, abs=0.005)
    assert found.interval.high == pytest.approx(alone.high, abs=0.005)
    certain = clustered_rate(np.ones(20), np.repeat(np.arange(5), 4), np.tile(range(4), 5))
    assert certain.interval == wilson_interval(5, 5)


def formula(k, n, z=1.959963984540054):
    p, centre = k / n, k / n + z * z / (2 * n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return (centre - half) / (1 + z * z / n), (centre + half) / (1 + z * z / n)


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    [
        # R. G. Newcombe, Statistics in Medicine 17 (1998), table I, method 3 (score without continuity correction).
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_agrees_with_the_published_table(k, n, low, high):
    interval = wilson_interval(k, n)
    assert (round(interval.low, 4), round(interval.high, 4)) == (low, high)


@given(counts)
def test_wilson_agrees_with_its_formula(count):
    interval = wilson_interval(*count)
    assert (interval.low, interval.high) == pytest.approx(formula(*count), abs=1e-9)


@pytest.mark.parametrize(
    ("k", "n", "confidence", "low", "high"),
    [
        (1, 2, 0.5, 0.2847588845819623, 0.7152411154180377),
        (1, 7, 0.95, 0.02567962434474355, 0.5131278292743189),
        (6, 20, 0.9, 0.1638594153519434, 0.4838037195924424),
        (14, 100, 0.9995, 0.05838602472360792, 0.29942004184180476),
        (133, 400, 0.8, 0.3030514026978436, 0.3633184613008851),
        (1763, 12345, 0.95, 0.13674999123587014, 0.1490939456704015),
        (999_999, 1_000_000, 0.95, 0.9999943350881957, 0.9999998234754233),
        (500_000_000, 1_000_000_000, 0.95, 0.4999690102484443, 0.5000309897515557),
    ],
)
def test_wilson_agrees_with_statsmodels(k, n, confidence, low, high):
    """Values of statsmodels 0.15, `proportion_confint(method="wilson")`."""
    interval = wilson_interval(k, n, confidence)
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=1e-12, rel=0)


@given(counts, st.floats(0.5, 0.999))
def test_wilson_contains_the_rate_and_stays_in_the_unit_interval(count, confidence):
    k, n = count
    interval = wilson_interval(k, n, confidence)
    assert 0 <= interval.low <= k / n <= interval.high <= 1
    assert (interval.low == 0) == (k == 0)
    assert (interval.high == 1) == (k == n)


@given(counts)
def test_wilson_of_failures_mirrors_wilson_of_successes(count):
    k, n = count
    here, there = wilson_interval(k, n), wilson_interval(n - k, n)
    assert (here.low, here.high) == pytest.approx((1 - there.high, 1 - there.low), abs=1e-12)


@given(counts)
def test_more_episodes_at_the_same_rate_narrow_the_interval(count):
    k, n = count
    few, many = wilson_interval(k, n), wilson_interval(4 * k, 4 * n)
    assert many.high - many.low < few.high - few.low


@given(counts)
def test_more_confidence_widens_the_interval(count):
    usual, surer = wilson_interval(*count), wilson_interval(*count, 0.99)
    assert surer.low <= usual.low <= usual.high <= surer.high


def test_without_trials_there_is_no_interval_no_rate_and_no_bounds():
    assert wilson_interval(0, 0) is None
    assert rate(0, 0) is None
    assert rate_bounds(0, 0, 0) is None
    assert wilson_intervals([], []) == []


def test_many_intervals_at_once_equal_the_single_ones():
    assert wilson_intervals([0, 3, 0, 7], [0, 9, 5, 7]) == [
        wilson_interval(k, n) for k, n in [(0, 0), (3, 9), (0, 5), (7, 7)]
    ]


@pytest.mark.parametrize(("k", "n"), [(-1, 5), (6, 5), (1, 0), (float("nan"), 5)])
def test_impossible_counts_are_refused(k, n):
    with pytest.raises(ValueError, match="0 <= successes <= trials"):
        wilson_interval(k, n)


@pytest.mark.parametrize("confidence", [0, 1, -0.5, 95, float("nan")])
def test_impossible_confidence_is_refused(confidence):
    with pytest.raises(ValueError, match="confidence between 0 and 1"):
        wilson_interval(1, 2, confidence)


def test_lengths_that_differ_are_refused():
    with pytest.raises(ValueError, match="as many successes as trials"):
        wilson_intervals([1, 2], [3])


def test_negative_counts_have_no_bounds():
    with pytest.raises(ValueError, match="0 <= successes <= trials"):
        rate_bounds(-1, 1, 0)


def test_bounds_are_all_errors_fail_and_all_errors_succeed():
    found = rate_bounds(6, 2, 2)
    assert (found.low, found.high) == (0.6, 0.8)
    assert found.interval == Interval(wilson_interval(6, 10).low, wilson_interval(8, 10).high)


@given(small, small, small)
def test_bounds_contain_the_rate_of_the_verdicts(successes, failures, without):
    found = rate_bounds(successes, failures, without)
    observed = rate(successes, successes + failures)
    if found is None:
        assert successes + failures + without == 0
        return
    assert found.interval.low <= found.low <= found.high <= found.interval.high
    if observed is not None:
        assert found.low - 1e-12 <= observed <= found.high + 1e-12


@given(small, small, small)
def test_each_further_error_widens_the_bounds(successes, failures, without):
    narrow, wide = rate_bounds(successes, failures, without), rate_bounds(successes, failures, without + 1)
    if narrow is not None:
        assert wide.low <= narrow.low
        assert wide.high >= narrow.high
