"""Quantile normalisation and its inverse."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from robogauntlet_mergevla.network.normalisation import Quantiles, Statistics, StatisticsError, TaskStatistics, padded
from tests.errors import one_line_error
from tests.mergevla.shared import some_statistics

NUMBERS = st.floats(-10, 10, allow_nan=False, width=32)


@given(arrays(np.float64, (5, 7), elements=st.floats(-1, 1)))
def test_normalising_is_the_inverse_of_restoring(normalised):
    statistics = some_statistics()
    back = statistics.normalise_actions(statistics.restore_actions(normalised))
    np.testing.assert_allclose(back, normalised, atol=1e-9)


@given(arrays(np.float64, (20, 8), elements=NUMBERS), arrays(np.float64, (3, 8), elements=NUMBERS))
def test_any_value_is_normalised_into_the_range(samples, values):
    assert (np.abs(Quantiles.of(samples).normalise(values)) <= 1.0).all()


def test_quantiles_are_the_ends_of_the_range():
    quantiles = Quantiles.of(np.arange(101.0)[:, None])
    assert quantiles == Quantiles((1.0,), (99.0,))
    np.testing.assert_allclose(quantiles.normalise([[1.0], [50.0], [99.0], [500.0]]).ravel(), [-1, 0, 1, 1])


def test_a_constant_number_is_normalised_to_zero_and_restored():
    quantiles = Quantiles((0.3,), (0.3,))
    assert quantiles.normalise([0.3]) == 0.0
    assert quantiles.restore([0.7]) == pytest.approx(0.3)


def test_the_gripper_is_only_clipped():
    statistics = some_statistics()
    actions = np.zeros((3, 7))
    actions[:, 6] = [-1.0, 0.25, 3.0]
    assert statistics.normalise_actions(actions)[:, 6].tolist() == [-1.0, 0.25, 1.0]
    assert statistics.restore_actions(actions)[:, 6].tolist() == [-1.0, 0.25, 1.0]


def test_statistics_are_read_back_from_json():
    assert Statistics.from_json(some_statistics().as_json()) == some_statistics()


def test_invalid_statistics_are_refused():
    with pytest.raises(StatisticsError, match=r"q01 <= q99, got 2\.0 and 1\.0"):
        Quantiles((2.0,), (1.0,))
    with pytest.raises(StatisticsError, match="finite"):
        Quantiles.of(np.full((3, 7), np.nan))
    with pytest.raises(StatisticsError, match="action statistics of 7 numbers, got 6"):
        Statistics.of(np.zeros((3, 6)), np.zeros((3, 8)))
    with pytest.raises(StatisticsError, match="n >= 1"):
        Quantiles.of(np.zeros((0, 7)))
    with pytest.raises(StatisticsError, match=r"normalisation statistics: action\.q01: Field required"):
        Statistics.from_json({"action": {}})


def test_each_row_is_normalised_by_its_own_task_and_restored():
    both = TaskStatistics({"a/x": some_statistics(0), "b/y": some_statistics(1)})
    unit = np.linspace(-1, 1, 2 * 3 * 7).reshape(2, 3, 7)
    restored = both.restore_actions(["b/y", "a/x"], unit)
    np.testing.assert_allclose(restored[0], some_statistics(1).restore_actions(unit[0]))
    np.testing.assert_allclose(restored[1], some_statistics(0).restore_actions(unit[1]))
    np.testing.assert_allclose(both.normalise_actions(["b/y", "a/x"], restored), unit, atol=1e-9)


def test_statistics_of_one_task_are_used_for_any_other_and_those_of_several_are_not():
    assert TaskStatistics({"a/x": some_statistics()}).of("b/y") == some_statistics()
    both = TaskStatistics({"a/x": some_statistics(0), "b/y": some_statistics(1)})
    with pytest.raises(StatisticsError, match="one of the trained tasks a/x, b/y, got 'c/z'"):
        both.of("c/z")


def test_small_ranges_of_actions_are_widened_and_constant_ones_stay_constant():
    actions = np.zeros((101, 7))
    actions[:, 0] = np.linspace(-0.02, 0.02, 101)
    actions[:, 4] = np.linspace(0.0, 0.02, 101)
    statistics = Statistics.of(actions, np.zeros((101, 8)))
    assert np.ptp(statistics.normalise_actions(actions), axis=0)[[0, 4]].tolist() == pytest.approx([2.0, 0.4])
    assert statistics.restore_actions(np.full((1, 7), 0.3))[0, 5] == 0.0
    np.testing.assert_allclose(statistics.restore_actions(statistics.normalise_actions(actions))[:, 4], actions[:, 4])


@given(arrays(np.float64, (5, 7), elements=st.floats(-1, 1)), st.integers(0, 1))
def test_statistics_of_several_tasks_together_cut_off_no_motion_of_one(normalised, task):
    both = TaskStatistics({"a/x": some_statistics(0), "b/y": some_statistics(1)})
    own = both.of(("a/x", "b/y")[task]).restore_actions(normalised)
    together = both.together("expert").of("a/x")
    np.testing.assert_allclose(together.restore_actions(together.normalise_actions(own)), own, atol=1e-9)


@given(arrays(np.float64, (4, 14), elements=st.floats(-1, 1)))
def test_in_a_network_of_two_arms_a_task_of_one_has_the_first_numbers_and_zeros_after_them(normalised):
    of_one, tasks = some_statistics(), ("null/One", "null/Two")
    two = Statistics.of(np.eye(14), np.eye(16))
    statistics = TaskStatistics({"null/One": of_one, "null/Two": two})
    restored = statistics.restore_actions(["null/One", "null/Two"] * 2, normalised)
    assert np.array_equal(restored[::2], padded(of_one.restore_actions(normalised[::2, :7]), 14))
    assert np.array_equal(restored[1::2], two.restore_actions(normalised[1::2]))
    assert statistics.is_used(tasks, 14).tolist() == [[True] * 7 + [False] * 7, [True] * 14]


def test_an_expert_of_several_tasks_has_actions_of_the_same_numbers():
    statistics = TaskStatistics({"a/one": some_statistics(), "a/two": Statistics.of(np.eye(14), np.eye(16))})
    with one_line_error(
        StatisticsError,
        "expected actions of the same numbers in the tasks of expert 'both', got 7 and 14; train an expert of each",
    ):
        statistics.together("both")
