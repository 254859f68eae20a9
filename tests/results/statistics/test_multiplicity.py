"""Many tests at once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from statsmodels.stats.multitest import multipletests

from results.statistics.multiplicity import benjamini_hochberg, e_benjamini_hochberg, holm

PUBLISHED = (
    0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344,
    0.0459, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0000,
)  # fmt: skip
"""The fifteen p-values of Benjamini and Hochberg (1995), section 4."""
p_values = st.lists(st.floats(0, 1), max_size=12)


def test_the_published_example_rejects_four_by_false_discovery_rate_and_three_by_family_wise_error():
    assert sum(p <= 0.05 for p in benjamini_hochberg(PUBLISHED)) == 4
    assert sum(p <= 0.05 for p in holm(PUBLISHED)) == 3


def test_holm_by_hand():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx((0.03, 0.06, 0.06))


@given(p_values)
def test_adjusting_never_makes_a_p_value_smaller_and_holm_is_the_stricter(found):
    strict, lenient = holm(found), benjamini_hochberg(found)
    assert all(p <= b + 1e-12 and b <= h + 1e-12 <= 1 + 1e-9 for p, b, h in zip(found, lenient, strict, strict=True))


def test_both_agree_with_statsmodels():
    for found in np.random.default_rng(0).random((20, 9)) ** 3:
        for own, name in ((holm, "holm"), (benjamini_hochberg, "fdr_bh")):
            assert own(found) == pytest.approx(multipletests(found, method=name)[1])


def test_one_test_is_not_adjusted():
    assert holm([0.04]) == benjamini_hochberg([0.04]) == (0.04,)
    assert holm([]) == benjamini_hochberg([]) == e_benjamini_hochberg([]) == ()


def test_e_values_by_hand():
    # K = 4, alpha = .1: the greatest k with k e_[k] >= 40 is 2, so those of at least 20 are rejected.
    assert e_benjamini_hochberg([100, 20, 13, 1], 0.1) == (True, True, False, False)
    assert e_benjamini_hochberg([39, 1, 1, 1], 0.1) == (False, False, False, False)


@given(st.lists(st.floats(0, 1e6), max_size=10), st.floats(0.01, 1))
def test_e_values_reject_what_the_same_procedure_rejects_of_their_inverses_as_p_values(found, alpha):
    inverses = [min(1.0, 1 / value) if value else 1.0 for value in found]
    by_p = [p <= alpha * (1 - 1e-9) for p in benjamini_hochberg(inverses)]
    by_e = e_benjamini_hochberg(found, alpha)
    assert all(e or not p for p, e in zip(by_p, by_e, strict=True)) or alpha == 1


@pytest.mark.parametrize("wrong", [[-0.1], [1.1], [float("nan")]])
def test_what_is_no_p_value_is_refused(wrong):
    for adjust in (holm, benjamini_hochberg):
        with pytest.raises(ValueError, match=r"expected p-values in \[0, 1\]"):
            adjust(wrong)


def test_what_is_no_e_value_is_refused():
    with pytest.raises(ValueError, match="expected e-values of 0 or more"):
        e_benjamini_hochberg([-1.0])
    with pytest.raises(ValueError, match="an alpha in"):
        e_benjamini_hochberg([1.0], 0.0)
