"""Agreement of two simulators."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import rankdata

from robogauntlet.results.statistics.rank_agreement import kendall, rank_violation

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
