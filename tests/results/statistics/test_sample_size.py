"""How many trials an interval or a paired test needs."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.results.statistics import sample_size
from robogauntlet.results.statistics.pairs import Pairs, detectable_drop, mcnemar
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.results.statistics.sample_size import (
    detectable_difference,
    half_width,
    independent_discordance,
    mcnemar_power,
    pairs_for_power,
    separate_difference,
    shrunk_share,
    trials_for_half_width,
)

share = st.floats(0.0, 1.0)
REFERENCE = {(0.2, 0.1): (155, 168), (0.25, 0.15): (85, 92), (0.3, 0.2): (57, 61), (0.2, 0.05): (626, 658)}
"""Discordance and difference to the pairs that Connor's formula and the exact test need, for 80 % at 0.05."""


@given(st.integers(0, 300), st.integers(1, 300))
def test_the_half_width_is_that_of_the_interval(successes, more):
    trials = successes + more
    interval = wilson_interval(successes, trials)
    assert half_width(successes / trials, trials) == pytest.approx((interval.high - interval.low) / 2)


@given(share, st.floats(0.003, 0.97))
def test_the_trials_for_a_half_width_are_the_fewest(rate, target):
    trials = trials_for_half_width(rate, target)
    assert half_width(rate, trials) <= target
    assert trials == 1 or half_width(rate, trials - 1) > target


def test_a_rate_of_one_half_needs_most_trials():
    found = [trials_for_half_width(rate, 0.05) for rate in (0.5, 0.7, 0.9, 1.0)]
    assert found == sorted(found, reverse=True)
    assert found[0] == 381  # 1.96² / 4 (1 / 0.05² - 4), rounded up


def test_few_trials_alike_are_no_certainty():
    assert 0.5 < shrunk_share(5, 5) < 1.0
    assert shrunk_share(0, 5) == pytest.approx(1 - shrunk_share(5, 5))
    assert shrunk_share(8_000_000, 10_000_000) == pytest.approx(0.8, abs=1e-6)
    with pytest.raises(ValueError, match="expected 0 <= successes <= trials"):
        shrunk_share(3, 2)


def test_independent_outcomes_disagree_most_around_one_half():
    first, second = np.meshgrid(np.linspace(0, 1, 101), np.linspace(0, 1, 101))
    disagree = first * (1 - second) + second * (1 - first)
    for difference in (0.0, 0.1, 0.4):
        with_it = np.isclose(first - second, difference)
        assert disagree[with_it].max() == pytest.approx(independent_discordance(difference), abs=1e-9)


@pytest.mark.parametrize(("discordance", "difference", "normal", "exact"), [(*k, *v) for k, v in REFERENCE.items()])
def test_the_pairs_for_four_of_five_are_those_of_the_reference(discordance, difference, normal, exact):
    """Connor's formula is a normal approximation, at which the exact test falls short."""
    found = pairs_for_power(discordance, difference)
    assert found == exact
    odd = round(discordance * normal)
    approximate = detectable_drop(Pairs(normal - odd, odd, 0, 0), 0.025)
    assert approximate == pytest.approx(difference, rel=0.01)
    assert mcnemar_power(normal, discordance, difference) < 0.8 <= mcnemar_power(found, discordance, difference)


@pytest.mark.parametrize(("discordance", "difference"), [*REFERENCE, (0.2, 0.2), (1.0, 0.3), (0.505, 0.1)])
def test_the_power_is_reached_in_simulated_comparisons(discordance, difference):
    generator = np.random.default_rng(1)
    pairs, draws = pairs_for_power(discordance, difference), 20_000
    cells = [(discordance + difference) / 2, (discordance - difference) / 2, 1 - discordance]
    counts, times = np.unique(generator.multinomial(pairs, cells, size=draws), axis=0, return_counts=True)
    found = [one > other and mcnemar(Pairs(0, one, other, rest)) <= 0.05 for one, other, rest in counts.tolist()]
    shown = times[found].sum() / draws
    assert shown == pytest.approx(mcnemar_power(pairs, discordance, difference), abs=0.01)
    assert shown >= 0.8 - 3 * math.sqrt(0.8 * 0.2 / draws)


@settings(deadline=None, max_examples=30)
@given(st.floats(0.02, 0.6), st.floats(0.0, 0.4), st.integers(1, 13))
def test_the_pairs_reach_the_power_in_whole_seeds_and_no_later_number_lacks_it(difference, more, step):
    discordance = min(difference + more, 1.0)
    found = pairs_for_power(discordance, difference, step=step)
    assert found % step == 0
    following = range(found, found + 10 * step, step) if found <= 1000 else (found,)
    assert min(mcnemar_power(pairs, discordance, difference) for pairs in following) >= 0.8


def test_more_disagreement_smaller_differences_and_smaller_alphas_need_more_pairs():
    by_discordance = [pairs_for_power(discordance, 0.1) for discordance in (0.1, 0.15, 0.2, 0.3, 0.5, 1.0)]
    by_difference = [pairs_for_power(0.4, difference) for difference in (0.4, 0.3, 0.2, 0.1, 0.05, 0.01, 0.002)]
    by_alpha = [pairs_for_power(0.2, 0.1, alpha) for alpha in (0.2, 0.05, 0.01, 0.001)]
    for found in (by_discordance, by_difference, by_alpha):
        assert all(fewer < more for fewer, more in pairwise(found))


def test_many_pairs_are_approximated_as_well_as_they_are_summed(monkeypatch):
    exact = pairs_for_power(0.2, 0.005)
    monkeypatch.setattr(sample_size, "MOST_EXACT", 1)
    assert pairs_for_power(0.2, 0.005) == pytest.approx(exact, rel=0.001)
    assert pairs_for_power(1.0, 1.0) >= 1


def test_the_detectable_difference_is_the_smallest_with_the_power():
    assert detectable_difference(168, 0.2) == pytest.approx(0.1, abs=0.001)
    found = detectable_difference(50, 0.1)
    assert mcnemar_power(50, max(0.1, found), found) >= 0.8
    assert mcnemar_power(50, max(0.1, found - 0.001), found - 0.001) < 0.8
    assert detectable_difference(5, 0.2) is None  # five wins of five have a p-value of 0.06
    assert detectable_difference(6, 0.2) is not None


@pytest.mark.parametrize(("discordance", "difference"), [(0.1, 0.2), (0.1, 0.0), (1.1, 0.2)])
def test_impossible_shares_are_refused(discordance, difference):
    for call in (lambda: mcnemar_power(10, discordance, difference), lambda: pairs_for_power(discordance, difference)):
        with pytest.raises(ValueError, match="expected 0 < difference <= discordance <= 1"):
            call()
    with pytest.raises(ValueError, match="expected a rate in"):
        trials_for_half_width(1.5, 0.1)


@pytest.mark.parametrize(("rate", "drop", "trials"), [(0.95, 0.05, 435), (0.6, 0.1, 388), (1.0, 0.05, 152)])
def test_the_smallest_drop_of_separate_groups_is_that_of_the_tables(rate, drop, trials):
    """Fleiss's formula without correction for continuity, rounded up to whole trials."""
    assert separate_difference(rate, trials) <= drop < separate_difference(rate, trials - 1)


@given(st.floats(0.05, 1.0), st.integers(20, 5000))
def test_more_trials_show_smaller_drops(rate, trials):
    less, more = (separate_difference(rate, number) for number in (trials, 2 * trials))
    assert less is None or more < less <= rate


@pytest.mark.parametrize(("rate", "trials"), [(0.0, 10), (1.1, 10), (0.5, 0)])
def test_a_drop_from_no_rate_or_without_trials_is_refused(rate, trials):
    with pytest.raises(ValueError, match="expected a rate in"):
        separate_difference(rate, trials)
