"""Agreement of two simulators."""

from itertools import combinations

import pytest
from hypothesis import given, strategies as st
from scipy.stats import rankdata

from robogauntlet.results.statistics.rank_agreement import agreement_bounds, kendall, pearson, rank_violation
from robogauntlet.results.statistics.rates import Interval

scores = st.lists(st.floats(0, 1), min_size=2, max_size=8)


def test_tau_has_known_values():
    assert kendall([1, 2, 3, 4], [1, 2, 4, 3])[0] == pytest.approx(4 / 6)  # five pairs agree, one does not
    assert kendall([1, 2, 3], [3, 2, 1])[0] == pytest.approx(-1)
    assert kendall([1, 1, 1], [1, 2, 3]) is None


def test_rank_violation_has_known_values():
    # The orders agree but for the second and third, whose scores on the first side are 0.2 apart.
    assert rank_violation([0.1, 0.5, 0.7, 0.9], [0.1, 0.6, 0.4, 0.9]) == pytest.approx((0 + 0.2 + 0.2 + 0) / 4)


@given(scores)
def test_a_change_of_scale_violates_nothing(found):
    assert rank_violation(found, list(rankdata(found))) == 0.0


@given(scores)
def test_the_reverse_order_violates_by_the_distance_to_the_farthest(found):
    expected = sum(max(abs(a - b) for b in found) for a in found) / len(found)
    assert rank_violation(found, [-score for score in found]) == pytest.approx(expected)


def test_pearsons_correlation_has_known_values():
    assert pearson([1, 2, 3], [1, 3, 2]) == pytest.approx(0.5)  # 1 of the roots of 2 and 2
    assert pearson([0, 1], [0.3, 0.1]) == -1.0
    assert pearson([0.1, 0.1], [1, 2]) is None


def test_bounds_have_known_values():
    # Three items: the first and second are in opposite orders, second and third in the same; of the others one is open.
    one = [Interval(0.2, 0.4), Interval(-0.1, 0.3), Interval(0.1, 0.2)]
    other = [Interval(-0.3, -0.1), Interval(0.1, 0.2), Interval(0.5, 0.6)]
    tau, violation = agreement_bounds(one, other, 3)
    assert tau == Interval(pytest.approx(-1 / 3), pytest.approx(1 / 3))
    assert violation == Interval(pytest.approx((0.2 + 0.2 + 0) / 3), pytest.approx((0.4 + 0.4 + 0.3) / 3))


@given(st.data())
def test_bounds_hold_for_all_scores_within_the_intervals(data):
    count = data.draw(st.integers(2, 6))
    rates, wide = st.lists(st.sampled_from([0, 0.25, 0.5, 1]), min_size=count, max_size=count), st.floats(0, 0.5)
    sides, intervals = [data.draw(rates) for _ in range(2)], []
    for own in sides:
        differences = [a - b for a, b in combinations(own, 2)]
        intervals.append([Interval(one - data.draw(wide), one + data.draw(wide)) for one in differences])
    tau, violation = agreement_bounds(*intervals, count)
    found = kendall(*sides)
    assert found is None or tau.low - 1e-9 <= found[0] <= tau.high + 1e-9
    assert violation.low - 1e-9 <= rank_violation(*sides) <= violation.high + 1e-9
