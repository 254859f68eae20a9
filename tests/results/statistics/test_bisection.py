"""The first checkpoint that lost half of what the last one lost."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from robogauntlet.results.statistics.bisection import (
    Bisection,
    EndsDoNotDiffer,
    bisect_checkpoints,
    log_betting_evidence,
)
from tests.jobs import mostly_nightly

SEEDS = 1_000


class Checkpoints:
    """Simulated checkpoints: on most seeds all of them meet the same difficulty. Counts and checks what is played."""

    def __init__(self, rates, seed, shared=0.7):
        generator = np.random.default_rng(seed)
        difficulty = np.where(
            generator.random((len(rates), SEEDS)) < shared,
            generator.random(SEEDS),
            generator.random((len(rates), SEEDS)),
        )
        self.outcomes = (difficulty < np.array(rates)[:, None]).astype(float)
        self.played = [0] * len(rates)

    def play(self, checkpoint, seeds):
        assert seeds.start == self.played[checkpoint]
        self.played[checkpoint] = seeds.stop
        return self.outcomes[checkpoint, seeds.start : seeds.stop]


def searched(rates, seed, **options):
    checkpoints = Checkpoints(rates, seed)
    found = bisect_checkpoints(len(rates) - 1, checkpoints.play, most_seeds=SEEDS, **options)
    assert found.episodes == sum(checkpoints.played)
    return found


@pytest.mark.parametrize(
    ("rates", "first"),
    [
        ([0.9] * 11 + [0.5] * 6, 11),
        ([0.9] * 3 + [0.6] * 6, 3),
        ([0.9, 0.88, 0.86, 0.84, 0.82, 0.8, 0.55, 0.54, 0.5], 6),
        ([0.9] * 8 + [0.5], 8),
        ([0.9, *[0.5] * 8], 1),
        ([0.9, 0.5], 1),
    ],
)
def test_the_first_checkpoint_that_lost_half_is_found(rates, first):
    found = [searched(rates, seed) for seed in range(40)]
    assert sum((one.last_good, one.first_worse) == (first - 1, first) for one in found) >= 38
    assert all(one.is_found and one.confidence == 0.95 for one in found)
    assert max(len(one.questions) for one in found) <= 1 + math.ceil(math.log2(len(rates) - 1))
    assert {question.is_worse for one in found for question in one.questions} <= {True, False}


@pytest.mark.parametrize("middle", mostly_nightly([0.7, 0.699, 0.71], [0.7]))
def test_a_result_is_wrong_in_at_most_one_search_of_twenty_even_if_a_checkpoint_lost_just_half(middle):
    """At 0.7 it lost exactly half, so that only "not worse" is wrong."""
    wrong = 0
    for seed in range(300):
        found = searched([0.9, 0.9, middle, 0.5, 0.5], seed)
        first = 2 if middle <= 0.7 else 3
        wrong += not found.last_good < first <= found.first_worse
    assert wrong <= 15


def test_a_checkpoint_that_cannot_be_decided_leaves_a_range():
    found = searched([0.9, 0.9, 0.7, 0.5, 0.5], 0)
    assert (found.last_good, found.first_worse, found.is_found) == (0, 4, False)
    assert found.questions[-1].is_worse is None
    assert found.questions[-1].seeds == SEEDS
    assert found.questions[-1].evidence < 60


def test_ends_that_do_not_differ_are_refused():
    refused = 0
    for seed in range(40):
        try:
            searched([0.7] * 5, seed)
        except EndsDoNotDiffer:
            refused += 1
    assert refused >= 38
    with pytest.raises(EndsDoNotDiffer, match="expected checkpoint 1 to be worse than checkpoint 0; 1,000 seeds: not"):
        searched([0.7, 0.7], 0)
    with pytest.raises(EndsDoNotDiffer, match="seeds: shown not to be"):
        searched([0.5, 0.9], 0)


def test_clear_losses_take_fewer_episodes_than_playing_every_checkpoint():
    """A fixed plan plays all 17 checkpoints, for a difference of 20 points with 20 % discordance about 60 times."""
    clear = np.mean([searched([0.9] * 11 + [0.5] * 6, seed).episodes for seed in range(40)])
    small = np.mean([searched([0.9] * 11 + [0.7] * 6, seed).episodes for seed in range(40)])
    assert clear < 17 * 60 / 2
    assert clear < small


def test_episodes_without_a_verdict_count_on_no_side():
    checkpoints = Checkpoints([0.9] * 3 + [0.4] * 2, 0)
    checkpoints.outcomes[:, ::3] = math.nan
    found = bisect_checkpoints(4, checkpoints.play, most_seeds=SEEDS)
    assert (found.last_good, found.first_worse) == (2, 3)
    never = Checkpoints([0.9, 0.1], 0)
    never.outcomes[1] = math.nan
    with pytest.raises(EndsDoNotDiffer, match="e-value 1, needed 20"):
        bisect_checkpoints(1, never.play, most_seeds=50)


@given(st.floats(0.1, 1.0), st.floats(0.1, 1.0), st.floats(0.1, 1.0))
def test_the_next_value_changes_nothing_on_average_if_its_mean_is_0(whole, half, none):
    """The value is 1 or -1, 1/2 or -1/2, or 0."""
    total = whole + half + none
    shares, values = np.array([whole, half, none]) / total, ([1.0, -1.0], [0.5, -0.5], [0.0, 0.0])
    mean = sum(
        share * np.mean([math.exp(log_betting_evidence(np.array([value]))) for value in pair])
        for share, pair in zip(shares, values, strict=True)
    )
    assert mean == pytest.approx(1.0)


def test_evidence_of_a_negative_mean_vanishes_and_that_of_a_positive_one_grows():
    assert log_betting_evidence(np.empty(0)) == pytest.approx(0.0)
    rising = [log_betting_evidence(np.ones(n)) for n in (1, 5, 20)]
    assert rising == sorted(rising)
    assert log_betting_evidence(-np.ones(20)) < -3
    assert log_betting_evidence(np.ones(5000)) > 700


def test_wrong_arguments_are_refused():
    def short(checkpoint, seeds):
        return [1.0]

    with pytest.raises(ValueError, match="expected 10 outcomes of checkpoint 0, got"):
        bisect_checkpoints(3, short)
    for arguments in ({"last": 0}, {"last": 3, "batch": 0}, {"last": 3, "alpha": 1.0}, {"last": 3, "most_seeds": 0}):
        with pytest.raises(ValueError, match="expected a last checkpoint, a batch and a number of seeds"):
            bisect_checkpoints(play=short, **arguments)
    assert Bisection(2, 3, 0.95, 10, ()).is_found


def test_seeds_that_cannot_decide_alone_are_played_together():
    calls = []

    def play(checkpoint, seeds):
        calls.append((checkpoint, seeds))
        return [float(checkpoint < 2)] * len(seeds)

    found = bisect_checkpoints(3, play, batch=5)
    assert (found.last_good, found.first_worse) == (1, 2)
    assert calls[:2] == [(0, range(10)), (3, range(10))]  # five wins in a row are no proof
    assert [seeds.start for checkpoint, seeds in calls if checkpoint in (1, 2)] == [0, 0]
