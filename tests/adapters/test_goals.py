"""Distances by a goal, and goals that do not fit a state."""

import numpy as np
import pytest

from robogauntlet.adapters.contract import Goal
from robogauntlet.adapters.goals import goal_distance, goal_mistakes

STATE = {
    "cube_position": np.array([0.5, 0.1, 0.02]),
    "goal_position": np.array([0.5, 0.4, 0.42]),
    "cube_quaternion": np.array([0.0, 0.0, 0.0, 1.0]),
    "hinge_angle": np.array([0.1]),
}


@pytest.mark.parametrize(
    ("goal", "distance"),
    [
        (Goal("cube_position", "goal_position"), 0.5),
        (Goal("cube_position", "goal_position", axes="xy"), 0.3),
        (Goal("cube_position", "goal_position", offset=(0.0, 0.0, -0.4)), 0.3),
        (Goal("cube_position", offset=(0.0, 0.3, 0.4), axes="z"), 0.5),
        (Goal("hinge_angle", offset=(0.3,), handle="cube_position"), 0.3),
    ],
)
def test_the_distance_is_along_the_axes_from_the_target_and_the_offset(goal, distance):
    assert goal_distance(goal, STATE[goal.entry], STATE[goal.to or goal.entry]) == pytest.approx(distance)
    assert not list(goal_mistakes(goal, STATE))


def test_a_goal_without_place_is_reached_by_more_than_its_offset():
    goal = Goal("cube_position", offset=(0.0, 0.0, 0.1))
    heights = np.array([[0.0, 0.0, z] for z in (0.0, 0.04, 0.3, -0.1)])
    assert goal_distance(goal, heights, heights[0]).tolist() == pytest.approx([0.1, 0.06, 0.0, 0.2])


def test_distances_of_many_times_are_those_of_each():
    goal = Goal("cube_position", "goal_position", offset=(0.0, 1.0, 0.0), axes="xy")
    value, to = np.array([[0.0, 0.0, 0.5], [1.0, 1.0, 0.5]]), np.array([[1.0, 1.0, 0.0]] * 2)
    assert goal_distance(goal, value, to).tolist() == pytest.approx([5**0.5, 1.0])


@pytest.mark.parametrize(
    ("goal", "field", "found"),
    [
        (Goal("cub_position", "goal_position"), "entry", "'cub_position'"),
        (Goal("cube_position", "gaol_position"), "to", "'gaol_position'"),
        (Goal("cube_position", "goal_position", handle="lid_position"), "handle", "'lid_position'"),
        (Goal("hinge_angle", "goal_position", handle="cube_position"), "to", "(3,)"),
        (Goal("hinge_angle", offset=(0.0, 0.0, 0.3), handle="cube_position"), "offset", "3"),
        (Goal("hinge_angle", offset=(0.1,), axes="z", handle="cube_position"), "axes", "'z'"),
        (Goal("hinge_angle", offset=(0.1,)), "handle", "(1,)"),
        (Goal("hinge_angle", offset=(0.1,), handle="cube_quaternion"), "handle", "(4,)"),
    ],
)
def test_a_goal_that_does_not_fit_the_state_is_described_by_its_field(goal, field, found):
    ((named, _, seen),) = goal_mistakes(goal, STATE)
    assert (named, seen) == (field, found)
