"""Adjustment for multiple tests."""

import pytest
from hypothesis import given, strategies as st

from robogauntlet.results.statistics.multiplicity import benjamini_hochberg, holm

PUBLISHED = (
    0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344,
    0.0459, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0000,
)  # fmt: skip
"""The fifteen p-values of Benjamini and Hochberg (1995), section 4."""
p_values = st.lists(st.floats(0, 1), max_size=12)


def test_the_published_example_rejects_four_by_false_discovery_rate_and_three_by_family_wise_error():
    assert sum(p <= 0.05 for p in benjamini_hochberg(PUBLISHED)) == 4
    assert sum(p <= 0.05 for p in holm(PUBLISHED)) == 3


def test_holm_has_known_values():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx((0.03, 0.06, 0.06))


@given(p_values)
def test_adjusting_never_makes_a_p_value_smaller_and_holm_is_the_stricter(found):
    strict, lenient = holm(found), benjamini_hochberg(found)
    assert all(p <= b + 1e-12 and b <= h + 1e-12 <= 1 + 1e-9 for p, b, h in zip(found, lenient, strict, strict=True))


def test_holm_agrees_with_statsmodels():
    """Values of statsmodels 0.15, `multipletests(method="holm")`."""
    assert holm(PUBLISHED[:6]) == pytest.approx((0.0006, 0.002, 0.0076, 0.0285, 0.0402, 0.0402))


def test_one_test_is_not_adjusted():
    assert holm([0.04]) == benjamini_hochberg([0.04]) == (0.04,)
    assert holm([]) == benjamini_hochberg([]) == ()


@pytest.mark.parametrize("wrong", [[-0.1], [1.1], [float("nan")]])
def test_values_outside_0_to_1_are_refused(wrong):
    for adjust in (holm, benjamini_hochberg):
        with pytest.raises(ValueError, match=r"expected p-values in \[0, 1\]"):
            adjust(wrong)
