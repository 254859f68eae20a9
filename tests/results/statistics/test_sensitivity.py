"""Sobol' indices of noisy outcomes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.results.statistics.sensitivity import sobol_indices
from robogauntlet.suites.designs import sobol_rows

few = settings(max_examples=25, deadline=None)


def generator(seed=0):
    return np.random.default_rng(seed)


def names(axes):
    return [f"axis {number}" for number in range(axes)]


def pick_freeze(points, axes, draw):
    """Rows of the design, shape (points, axes + 2, axes)."""
    return sobol_rows(axes, points, draw).reshape(points, axes + 2, axes)


def exact(rate, axes=3, points=1024, seeds=3):
    """Outcomes that are the rates themselves, the same at every seed."""
    return np.repeat(rate(pick_freeze(points, axes, generator()))[..., None], seeds, axis=2)


def drawn(rate, axes=3, points=64, seeds=4, seed=0):
    draw = generator(seed)
    rates = rate(pick_freeze(points, axes, draw))
    return (draw.random((*rates.shape, seeds)) < rates[..., None]).astype(float)


def ishigami(levels):
    x, y, z = np.moveaxis(np.pi * (2 * levels - 1), -1, 0)
    found = np.sin(x) * (1 + 0.1 * z**4) + 7 * np.sin(y) ** 2
    return (found + 1 + 0.1 * np.pi**4) / (9 + 0.2 * np.pi**4)


def linear(levels):
    """Half of the range from the first axis, a quarter from the second, none from the third."""
    return 0.125 + levels @ np.array([0.5, 0.25, 0.0])


def totals(found):
    return [axis.total.value for axis in found.axes]


def ends(found):
    return [(e.value, e.interval.low, e.interval.high) for e in (axis.total for axis in found.axes)]


def test_without_noise_the_indices_of_ishigami_are_the_analytic_ones():
    found = sobol_indices(exact(ishigami, points=4096), names(3))
    assert totals(found) == pytest.approx([0.5576, 0.4424, 0.2437], abs=0.03)
    assert found.explained.value == pytest.approx(1)


def test_the_indices_agree_with_sums_over_pairs_of_seeds():
    outcomes = drawn(linear, points=256, seeds=3, seed=1)
    n, rows, k = outcomes.shape
    centred = outcomes - outcomes.mean(axis=0)

    def covariance(one, other):
        pairs = [(s, t) for s in range(k) for t in range(k) if s != t]
        return sum(centred[:, one, s] @ centred[:, other, t] for s, t in pairs) / len(pairs) / (n - 1)

    variance = np.mean([covariance(row, row) for row in range(rows)])
    total = [(covariance(0, 0) + covariance(a, a) - 2 * covariance(0, a)) / 2 / variance for a in (1, 2, 3)]
    noise = outcomes.var(axis=2, ddof=1).mean()
    found = sobol_indices(outcomes, names(3))
    assert totals(found) == pytest.approx(np.clip(total, 0, 1))
    assert found.explained.value == pytest.approx(variance / (variance + noise))


def test_the_noise_of_rollouts_is_no_interaction():
    """Products of one seed's outcomes would add 0.25 to a variance of 0.026."""
    outcomes = np.concatenate([drawn(linear, points=1024, seed=seed) for seed in range(8)])
    found = sobol_indices(outcomes, names(3))
    assert totals(found) == pytest.approx([0.8, 0.2, 0], abs=0.06)
    assert found.explained.value == pytest.approx(0.026 / 0.25, abs=0.01)


def test_effects_of_seeds_are_no_effects_of_axes():
    """A shift of each seed, alike at all points, changes the variance of a rollout alone."""
    outcomes = exact(linear, seeds=4) / 2
    shifted = outcomes + np.array([0.0, 0.1, 0.2, 0.4])
    one, other = (sobol_indices(each, names(3)) for each in (outcomes, shifted))
    assert totals(one) == pytest.approx(totals(other))
    assert one.explained.value > other.explained.value


@given(st.permutations(range(3)), st.integers(0, 20))
@few
def test_permuting_the_axes_permutes_the_indices(order, seed):
    outcomes = drawn(linear, seeds=8, seed=seed)
    there = sobol_indices(outcomes, names(3))
    back = sobol_indices(outcomes[:, [0, *(1 + axis for axis in order), 4]], [names(3)[axis] for axis in order])
    assert (there.axes is None) == (back.axes is None)
    if there.axes is not None:
        by_name = {axis.axis: axis for axis in back.axes}
        for axis in there.axes:
            assert axis.total.value == pytest.approx(by_name[axis.axis].total.value)
            assert axis.total.interval.high == pytest.approx(by_name[axis.axis].total.interval.high, abs=0.003)


@given(st.integers(0, 200), st.sampled_from([2, 4, 16]), st.integers(2, 4), st.integers(1, 3))
@few
def test_estimates_and_intervals_are_shares_and_an_estimate_lies_in_its_interval(seed, points, seeds, axes):
    outcomes = (generator(seed).random((points, axes + 2, seeds)) < 0.5).astype(float)
    found = sobol_indices(outcomes, names(axes))
    estimates = [axis.total for axis in found.axes or ()]
    for estimate in [*estimates, *([found.explained] if found.explained else [])]:
        assert 0 <= estimate.value <= 1
        if estimate.interval is not None:
            assert 0 <= estimate.interval.low <= estimate.value <= estimate.interval.high <= 1


def test_a_constant_outcome_has_no_indices():
    found = sobol_indices(np.ones((8, 5, 3)), names(3))
    assert found.axes is found.explained is None


def test_outcomes_without_an_effect_of_axes_have_no_indices():
    half = drawn(lambda levels: np.full(levels.shape[:-1], 0.5), seeds=10)
    found = sobol_indices(half, names(3))
    assert found.axes is None
    assert found.explained.interval.low == 0
    assert sobol_indices(half[..., :9], names(3)).explained.interval is None


def test_two_seeds_give_indices_without_intervals():
    found = sobol_indices(drawn(linear, points=1024, seeds=2), names(3))
    assert totals(found) == pytest.approx([0.8, 0.2, 0], abs=0.3)
    assert all(axis.total.interval is None for axis in found.axes)


def test_an_axis_that_never_changes_an_outcome_has_a_total_of_zero_without_an_interval():
    found = sobol_indices(exact(linear), names(3))
    assert (found.axes[2].total.value, found.axes[2].total.interval) == (0, None)


def broken(levels):
    """Both of two axes beyond half of their range; a third has no effect."""
    return np.where((levels[..., :2] > 0.5).all(axis=-1), 0.1, 0.95)


@pytest.mark.parametrize(
    ("rate", "true"), [(ishigami, [0.5576, 0.4424, 0.2437]), (linear, [0.8, 0.2, 0]), (broken, [2 / 3, 2 / 3, 0])]
)
def test_intervals_contain_the_true_index_with_their_confidence(rate, true):
    """`studies/intervals` has more experiments, sizes and responses."""
    inside = []
    for seed in range(100):
        found = sobol_indices(drawn(rate, seeds=10, seed=seed), names(3))
        intervals = [axis.total.interval for axis in found.axes or ()]
        inside += [i.low <= value <= i.high for i, value in zip(intervals, true, strict=False)]
    assert np.mean(inside) > 0.93


@pytest.mark.parametrize(
    ("shape", "axes", "message"),
    [
        ((8, 4, 3), 3, r"expected outcomes of shape \(base points, 5, seeds\), got \(8, 4, 3\)"),
        ((8, 5), 3, "expected outcomes of shape"),
        ((8, 2, 3), 0, "expected outcomes of shape"),
        ((1, 5, 3), 3, "expected at least two base points and two seeds, got 1 and 3"),
        ((8, 5, 1), 3, "expected at least two base points and two seeds, got 8 and 1"),
    ],
)
def test_outcomes_of_another_shape_are_refused(shape, axes, message):
    with pytest.raises(ValueError, match=message):
        sobol_indices(np.zeros(shape), names(axes))


@pytest.mark.parametrize("wrong", [-0.1, 1.1, np.nan])
def test_outcomes_outside_0_to_1_or_missing_are_refused(wrong):
    outcomes = np.zeros((8, 5, 3))
    outcomes[0, 0, 0] = wrong
    with pytest.raises(ValueError, match=r"expected outcomes in \[0, 1\] and none missing"):
        sobol_indices(outcomes, names(3))
