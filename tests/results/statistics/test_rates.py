"""Success rates and their intervals."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from results.statistics.rates import (
    Interval,
    clopper_pearson_interval,
    rate,
    rate_bounds,
    wilson_interval,
    wilson_intervals,
)

counts = st.integers(1, 10_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))
small = st.integers(0, 500)


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
    assert interval is not None
    assert (round(interval.low, 4), round(interval.high, 4)) == (low, high)


@given(counts)
def test_wilson_agrees_with_its_formula(count):
    interval = wilson_interval(*count)
    assert interval is not None
    assert (interval.low, interval.high) == pytest.approx(formula(*count), abs=1e-9)


@given(counts, st.floats(0.5, 0.999))
def test_wilson_contains_the_rate_and_stays_in_the_unit_interval(count, confidence):
    k, n = count
    interval = wilson_interval(k, n, confidence)
    assert interval is not None
    assert 0 <= interval.low <= k / n <= interval.high <= 1
    assert (interval.low == 0) == (k == 0)
    assert (interval.high == 1) == (k == n)


@given(counts)
def test_wilson_is_the_same_for_failures_seen_from_the_other_side(count):
    k, n = count
    here, there = wilson_interval(k, n), wilson_interval(n - k, n)
    assert here is not None
    assert there is not None
    assert (here.low, here.high) == pytest.approx((1 - there.high, 1 - there.low), abs=1e-12)


@given(counts)
def test_more_episodes_at_the_same_rate_narrow_the_interval(count):
    k, n = count
    few, many = wilson_interval(k, n), wilson_interval(4 * k, 4 * n)
    assert few is not None
    assert many is not None
    assert many.high - many.low < few.high - few.low


@given(counts)
def test_more_confidence_widens_the_interval(count):
    usual, surer = wilson_interval(*count), wilson_interval(*count, 0.99)
    assert usual is not None
    assert surer is not None
    assert surer.low <= usual.low <= usual.high <= surer.high


def test_without_trials_there_is_no_interval_no_rate_and_no_bounds():
    assert wilson_interval(0, 0) is None
    assert rate(0, 0) is None
    assert rate_bounds(0, 0, 0) is None
    assert wilson_intervals([], []) == []


def test_many_at_once_give_what_each_gives_alone():
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
    with pytest.raises(ValueError, match="confidence between 0 and 1"):
        rate_bounds(1, 1, 1, confidence)


def test_lengths_that_differ_are_refused():
    with pytest.raises(ValueError, match="as many successes as trials"):
        wilson_intervals([1, 2], [3])


def test_negative_counts_have_no_bounds():
    with pytest.raises(ValueError, match="expected counts"):
        rate_bounds(1, -1, 0)


def test_bounds_are_all_errors_fail_and_all_errors_succeed():
    found = rate_bounds(6, 2, 2)
    assert found is not None
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


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    [(81, 263, 0.2527, 0.3676), (15, 148, 0.0578, 0.1617), (0, 20, 0.0, 0.1684), (1, 29, 0.0009, 0.1776)],
)
def test_clopper_and_pearson_agree_with_the_published_table(k, n, low, high):
    """R. G. Newcombe, Statistics in Medicine 17 (1998) 857-872, table I, method 5."""
    found = clopper_pearson_interval(k, n)
    assert found is not None
    assert (round(found.low, 4), round(found.high, 4)) == (low, high)


@pytest.mark.parametrize("rate", [0.05, 0.2, 0.5, 0.95])
def test_clopper_and_pearson_cover_every_rate_with_the_confidence_at_least(rate):
    covered = 0.0
    for k in range(31):
        found = clopper_pearson_interval(k, 30)
        if found.low <= rate <= found.high:
            covered += math.comb(30, k) * rate**k * (1 - rate) ** (30 - k)
    assert covered >= 0.95


def test_clopper_and_pearson_refuse_impossible_counts_and_know_nothing_without_trials():
    assert clopper_pearson_interval(0, 0) is None
    with pytest.raises(ValueError, match="expected 0 <= successes <= trials"):
        clopper_pearson_interval(3, 2)
