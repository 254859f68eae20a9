"""Paired comparison of two policies."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, strategies as st

from robogauntlet.results.statistics.pairs import (
    Pairs,
    can_reject,
    detectable_drop,
    is_no_worse,
    mcnemar,
    mcnemar_worse,
    paired_difference,
    paired_ratio,
    pooled,
)
from robogauntlet.results.statistics.rates import wilson_interval

count = st.integers(0, 200)
tables = st.builds(Pairs, count, count, count, count).filter(lambda pairs: pairs.trials > 0)


def test_the_difference_agrees_with_a_published_example():
    """Cavo et al. (2012) as worked in Fagerland, Lydersen and Laake, Statistical Analysis of Contingency Tables (2017),
    chapter 8: complete response before and after a therapy.
    """
    found = paired_difference(Pairs(59, 6, 16, 80))
    numbers = (found.value, found.interval.low, found.interval.high)
    assert [round(number, 4) for number in numbers] == [-0.0621, -0.1186, -0.0046]


def test_without_correlation_the_wilson_intervals_are_added_in_squares():
    """One side always succeeds, so that phi is 0 and the formula is that of independent rates."""
    found, rate = paired_difference(Pairs(30, 10, 0, 0)), wilson_interval(30, 40)
    one = wilson_interval(40, 40)
    assert found.interval.low == pytest.approx(0.25 - math.hypot(1 - one.low, rate.high - 0.75))
    assert found.interval.high == pytest.approx(0.25 + (0.75 - rate.low))


@given(tables)
def test_the_difference_lies_in_its_interval_and_that_in_the_possible(pairs):
    found = paired_difference(pairs)
    assert -1 <= found.interval.low <= found.value <= found.interval.high <= 1
    assert found.value == pytest.approx((pairs.first_only - pairs.second_only) / pairs.trials)


@given(tables)
def test_exchanging_the_sides_changes_the_sign(pairs):
    there = paired_difference(pairs)
    back = paired_difference(Pairs(pairs.both, pairs.second_only, pairs.first_only, pairs.neither))
    assert (there.value, there.interval.low, there.interval.high) == pytest.approx(
        (-back.value, -back.interval.high, -back.interval.low)
    )


@given(tables)
def test_more_pairs_alike_narrow_the_interval(pairs):
    few = paired_difference(pairs)
    many = paired_difference(Pairs(4 * pairs.both, 4 * pairs.first_only, 4 * pairs.second_only, 4 * pairs.neither))
    assert many.interval.high - many.interval.low < few.interval.high - few.interval.low + 1e-12


def test_without_pairs_there_is_no_difference():
    assert paired_difference(Pairs(0, 0, 0, 0)) is None


def every_table(n):
    for both, first, second in product(range(n + 1), repeat=3):
        if both + first + second <= n:
            yield Pairs(both, first, second, n - both - first - second)


def chance(pairs, cells):
    counts = (pairs.both, pairs.first_only, pairs.second_only, pairs.neither)
    ways = math.factorial(pairs.trials) / math.prod(map(math.factorial, counts))
    return ways * math.prod(p**k for p, k in zip(cells, counts, strict=True))


def test_the_interval_covers_the_true_difference_with_its_confidence():
    """Exactly, over all tables of 15 pairs: never far below 95 %, on average not below."""
    found = [(pairs, paired_difference(pairs).interval) for pairs in every_table(15)]
    covered = []
    for cells in [(0.8, 0.1, 0.05, 0.05), (0.9, 0.04, 0.04, 0.02), (0.4, 0.3, 0.1, 0.2), (0.5, 0.0, 0.2, 0.3)]:
        true = cells[1] - cells[2]
        covered.append(sum(chance(pairs, cells) for pairs, i in found if i.low <= true <= i.high))
    assert min(covered) > 0.93
    assert np.mean(covered) > 0.95


some_successes = tables.filter(lambda pairs: pairs.second > 0)


def test_the_ratio_agrees_with_a_published_example():
    """Bentur et al. (2009) as worked in the same book: 0.25, Tang's interval 0.065 to 0.907; McNemar's p is 0.070."""
    found = paired_ratio(Pairs(1, 1, 7, 12))
    assert [found.value, round(found.interval.low, 3), found.interval.high] == [0.25, 0.065, 1.0]


@given(some_successes)
def test_the_interval_of_the_ratio_contains_it_and_excludes_equal_rates_where_mcnemar_does(pairs):
    found = paired_ratio(pairs)
    assert 0 <= found.interval.low <= found.value <= found.interval.high < math.inf
    assert (found.interval.low <= 1 <= found.interval.high) is (mcnemar(pairs) > 0.05)


@given(some_successes.filter(lambda pairs: pairs.first > 0))
def test_exchanged_sides_have_the_inverse_ratio(pairs):
    one, other = map(paired_ratio, (pairs, Pairs(pairs.both, pairs.second_only, pairs.first_only, 5)))
    assert other.value == pytest.approx(1 / one.value)
    assert other.interval.low == pytest.approx(1 / one.interval.high)


@given(some_successes.filter(lambda pairs: pairs.both > 0))
def test_a_success_more_of_the_second_side_alone_lowers_the_ratio_and_its_interval(pairs):
    one = paired_ratio(pairs)
    other = paired_ratio(Pairs(pairs.both - 1, pairs.first_only, pairs.second_only + 1, pairs.neither))
    assert other.value < one.value
    assert other.interval.low <= one.interval.low + 1e-9
    assert other.interval.high <= one.interval.high + 1e-9


def test_sides_that_agree_have_an_interval_that_narrows_with_trials():
    few, many = (paired_ratio(Pairs(n, 0, 0, 0)).interval for n in (10, 1000))
    assert few.low < many.low < 1 < many.high < few.high


def test_without_successes_of_the_second_side_there_is_no_ratio():
    assert paired_ratio(Pairs(0, 3, 0, 7)) is None


@pytest.mark.parametrize("cells", [(0.94, 0.02, 0.04, 0.0), (0.85, 0.02, 0.08, 0.05), (0.3, 0.2, 0.3, 0.2)])
def test_the_interval_of_the_ratio_covers_the_true_ratio_with_its_confidence(cells):
    """Exactly, over all tables of 15 pairs."""
    true = (cells[0] + cells[1]) / (cells[0] + cells[2])
    found = ((pairs, paired_ratio(pairs)) for pairs in every_table(15))
    assert sum(chance(pairs, cells) for pairs, r in found if r and r.interval.low <= true <= r.interval.high) > 0.94


def test_mcnemar_agrees_with_a_published_example():
    """The same example of Fagerland, Lydersen and Laake: 6 and 16 pairs disagree, exact conditional p = 0.0525."""
    assert mcnemar(Pairs(59, 6, 16, 80)) == pytest.approx(0.0525, abs=5e-5)


@given(tables)
def test_mcnemar_is_twice_the_smaller_tail_of_a_fair_coin(pairs):
    n, least = pairs.first_only + pairs.second_only, min(pairs.first_only, pairs.second_only)
    tail = sum(math.comb(n, k) for k in range(least + 1)) / 2**n
    assert mcnemar(pairs) == pytest.approx(min(1.0, 2 * tail))


def test_mcnemar_rejects_equal_rates_in_at_most_one_experiment_of_twenty():
    drawn = np.random.default_rng(0).multinomial(100, [0.4, 0.1, 0.1, 0.4], size=1000)
    assert np.mean([mcnemar(Pairs(*map(int, counts))) <= 0.05 for counts in drawn]) <= 0.05


def test_pooling_adds_the_strata_up():
    assert pooled([Pairs(1, 2, 3, 4), Pairs(10, 20, 30, 40)]) == Pairs(11, 22, 33, 44)
    assert pooled([]) == Pairs(0, 0, 0, 0)


def test_no_worse_needs_enough_pairs_and_not_only_a_large_p_value():
    few, many = Pairs(9, 0, 0, 1), Pairs(900, 20, 20, 60)
    assert mcnemar(few) == mcnemar(many) == 1.0
    assert not is_no_worse(few)
    assert is_no_worse(many)
    assert not is_no_worse(Pairs(900, 0, 100, 0))
    with pytest.raises(ValueError, match="expected a margin between 0 and 1"):
        is_no_worse(many, margin=0.0)


def test_a_side_that_is_worse_by_the_margin_is_called_no_worse_in_at_most_one_experiment_of_forty():
    drawn = np.random.default_rng(1).multinomial(200, [0.80, 0.03, 0.08, 0.09], size=1000)
    assert np.mean([is_no_worse(Pairs(*map(int, counts))) for counts in drawn]) <= 0.025 + 0.01


@pytest.mark.parametrize(
    ("disagree", "drop", "pairs"), [(0.2, 0.1, 155), (0.25, 0.15, 85), (0.3, 0.2, 56), (0.2, 0.05, 626)]
)
def test_the_detectable_drop_agrees_with_published_sample_sizes(disagree, drop, pairs):
    """Two-sided at 5 %, 80 % power (Connor 1987's formula), rounded up to whole pairs."""
    rows = round(disagree * pairs)
    found = detectable_drop(Pairs(pairs - rows, rows, 0, 0), alpha=0.025)
    assert found == pytest.approx(drop, abs=0.004)


@given(tables)
def test_a_smaller_drop_needs_more_pairs(pairs):
    found = detectable_drop(pairs, 0.05)
    more = Pairs(4 * pairs.both, 4 * pairs.first_only, 4 * pairs.second_only, 4 * pairs.neither)
    assert found is None or detectable_drop(more, 0.05) < found


@given(tables)
def test_the_one_sided_p_values_overlap_by_the_probability_of_the_table(pairs):
    worse, better = mcnemar_worse(pairs), mcnemar_worse(Pairs(pairs.both, pairs.second_only, pairs.first_only, 0))
    disagree = pairs.first_only + pairs.second_only
    assert worse + better == pytest.approx(1 + math.comb(disagree, pairs.first_only) * 0.5**disagree)
    assert mcnemar(pairs) == pytest.approx(min(1.0, 2 * min(worse, better)))


@given(tables, st.floats(0.001, 0.4))
def test_a_family_leaves_out_what_could_not_be_rejected_if_all_were_worse(pairs, alpha):
    disagree = pairs.first_only + pairs.second_only
    assert can_reject(pairs, alpha) == (disagree > 0 and mcnemar_worse(Pairs(0, 0, disagree, 0)) <= alpha)
