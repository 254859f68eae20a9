"""The best of several, without the winner's curse."""

import numpy as np
import pytest

from robogauntlet.results.statistics.held_out import HeldOutBest, held_out_best
from robogauntlet.results.statistics.rates import Estimate, wilson_interval


def test_the_best_of_the_first_half_has_the_rate_of_the_second():
    found = held_out_best([(5, 10), (9, 10), (8, 10)], [(10, 10), (4, 8), (9, 10)])
    assert found == HeldOutBest(1, (9, 10), (4, 8), Estimate(0.5, wilson_interval(4, 8)))


@pytest.mark.parametrize(
    ("choosing", "measuring", "best"),
    [
        ([(4, 10), (4, 10)], [(0, 10), (10, 10)], 0),
        ([(2, 2), (9, 10)], [(0, 0), (1, 1)], 1),
        ([(0, 0), (1, 10)], [(1, 1), (1, 1)], 1),
        ([(3, 4), (8, 10)], [(1, 1), (1, 1)], 1),
    ],
    ids=["the first of equal ones", "not measured", "nothing to choose by", "by rate"],
)
def test_what_is_chosen(choosing, measuring, best):
    assert held_out_best(choosing, measuring).index == best


@pytest.mark.parametrize("counts", [[], [(0, 0)]])
def test_without_trials_there_is_no_best(counts):
    assert held_out_best(counts, [(0, 0)] * len(counts)) is None


def test_halves_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match="expected counts of 2 candidates on both halves, got 1"):
        held_out_best([(1, 2), (1, 2)], [(1, 2)])


@pytest.mark.parametrize("rate", [0.3, 0.7])
def test_the_rate_of_the_best_of_equal_checkpoints_is_unbiased_and_covered(rate):
    """Ten checkpoints that are equally good, on ten seeds of each half, which all of them share."""
    repeats, seeds = 4_000, 10
    generator = np.random.default_rng(0)
    shared = np.where(  # seeds differ in how hard they are, for all checkpoints alike
        generator.random((repeats, 10, 2 * seeds)) < 0.5,
        generator.random((repeats, 1, 2 * seeds)),
        generator.random((repeats, 10, 2 * seeds)),
    )
    successes = (shared < rate).reshape(repeats, 10, 2, seeds).sum(axis=3)
    found = [
        held_out_best([(int(k), seeds) for k in one[:, 0]], [(int(k), seeds) for k in one[:, 1]]) for one in successes
    ]
    error = np.sqrt(rate * (1 - rate) / seeds / repeats)
    assert np.mean([one.estimate.value for one in found]) == pytest.approx(rate, abs=4 * error)
    assert np.mean([one.chosen_on[0] / seeds for one in found]) > rate + 40 * error  # the curse that is avoided
    covered = [one.estimate.interval.low <= rate <= one.estimate.interval.high for one in found]
    assert np.mean(covered) > 0.92
