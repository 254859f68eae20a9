"""What the contract's values refuse, and the numbers of two arms."""

import numpy as np
import pytest

from robogauntlet.adapters.contract import (
    ACTION_NAMES,
    ActionSpec,
    Body,
    Goal,
    Joint,
    Moves,
    Number,
    Observation,
    TaskDescription,
)
from robogauntlet.adapters.frames import proprioception


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"entry": ""}, "entry: expected the name of an entry"),
        *(({"axes": axes}, "axes: expected letters out of 'xyz'") for axes in ("", "xw", "X", "xx")),
        *(
            ({"offset": offset}, "offset: expected 1 or 3 finite numbers")
            for offset in ((), (0.0, 0.0), (float("nan"),))
        ),
        ({"entry": "hinge_angle"}, "offset: expected a change from the start"),
        *(
            ({"tolerance": value}, "tolerance: expected a finite number")
            for value in (-0.01, float("inf"), float("nan"))
        ),
    ],
)
def test_a_goal_that_cannot_be_measured_is_refused_with_the_name_of_the_value(values, says):
    with pytest.raises(ValueError, match=f"^{says}"):
        Goal(**{"entry": "cube_position", **values})


def test_a_goal_takes_any_axes_once_and_an_offset_for_all_or_for_each():
    assert Goal("cube_position", axes="zx", offset=(0.0, 0.0, 0.1)).axes == "zx"
    assert Goal("hinge_angle", offset=(0.3,)).offset == (0.3,)


def test_an_action_of_two_arms_has_the_numbers_of_the_first_and_then_those_of_the_second():
    spec = ActionSpec(0.02, 0.1, 20.0, ignored=("rz", "second_gripper"), arms=2)
    assert spec.names == (*ACTION_NAMES, *(f"second_{name}" for name in ACTION_NAMES))
    assert np.array_equal(spec.high, np.tile(ActionSpec(0.02, 0.1, 20.0).high, 2))
    assert np.array_equal(spec.low, -spec.high)
    assert spec.ignored_indices == [5, 13]


@pytest.mark.parametrize("arms", [0, 3, None])
def test_other_numbers_of_arms_than_one_and_two_are_refused(arms):
    for make in (lambda: ActionSpec(0.02, 0.1, 20.0, arms=arms), lambda: TaskDescription("lift", 60, arms=arms)):
        with pytest.raises(ValueError, match=f"^arms: expected 1 or 2, found {arms}$"):
            make()


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ({"velocities": True}, "^velocities: expected joints beside it, found none$"),
        ({"joints": ("a", "gripper")}, "^joints: .* none of an action of a tool, found 'gripper'$"),
        ({"joints": ("a", "a")}, "^joints: expected a name for each, .* found 'a'$"),
        ({"native": ("x",), "joints": ("a",)}, "^native: expected no joints and one arm beside it$"),
        ({"native": ("x",), "arms": 2}, "^native: expected no joints and one arm beside it$"),
        ({"native": ("x", "x")}, "^native: expected another name for each number, found 'x' twice$"),
        ({"state": ("x",)}, "^state: expected native beside it, found none$"),
    ],
)
def test_a_body_whose_numbers_are_not_known_by_their_names_is_refused(body, says):
    with pytest.raises(ValueError, match=says):
        Body(**body)


def test_targets_of_joints_have_their_names_limits_and_largest_steps():
    joints = (Joint("shoulder", -1.0, 2.0, 0.1), Joint("elbow", -0.5, 0.5, 0.2))
    spec = ActionSpec(0.0, 0.0, 20.0, joints=joints)
    assert spec.names == spec.body.proprioception_names == ("shoulder", "elbow", "gripper")
    assert spec.low.tolist() == [-1.0, -0.5, -1.0]
    assert spec.high.tolist() == [2.0, 0.5, 1.0]
    assert spec.steps[:2].tolist() == [0.1, 0.2]


def test_velocities_of_the_joints_of_two_arms_have_their_names_and_bounds():
    joints = (Joint("shoulder", -1.0, 2.0, 0.1), Joint("elbow", -0.5, 0.5, 0.2))
    spec = ActionSpec(0.0, 0.0, 20.0, arms=2, joints=joints, velocities=True)
    one = ("shoulder_velocity", "elbow_velocity", "gripper")
    assert spec.names == (*one, *(f"second_{name}" for name in one))
    assert spec.body.proprioception_names[3:] == ("second_shoulder", "second_elbow", "second_gripper")
    assert spec.high.tolist() == [2.0, 4.0, 1.0] * 2
    assert np.array_equal(spec.low, -spec.high)
    assert [spec.names[spec.joints_of(arm)][0] for arm in (0, 1)] == ["shoulder_velocity", "second_shoulder_velocity"]


def test_native_numbers_have_the_names_and_bounds_of_their_environment():
    spec = ActionSpec(0.0, 0.0, 10.0, ("y",), numbers=(Number("x", 0.0, 512.0), Number("y")), state=("x", "y", "speed"))
    assert (spec.names, spec.body.proprioception_names, spec.ignored_indices) == (("x", "y"), ("x", "y", "speed"), [1])
    assert spec.body.moves is Moves.NATIVE
    assert (spec.low.tolist(), spec.high.tolist()) == ([0.0, -np.inf], [512.0, np.inf])
    assert Observation({}, np.zeros(3), "", native=2).action_dim == 2


def test_a_goal_beside_native_numbers_is_refused():
    with pytest.raises(ValueError, match=r"^goal: expected none beside native numbers"):
        TaskDescription("go", 10, native=("x",), goal=Goal("x_position", "y_position"))


def test_the_numbers_of_one_arm_have_no_prefix():
    assert ActionSpec(0.02, 0.1, 20.0).names == ACTION_NAMES


def test_proprioception_of_two_arms_is_that_of_each_in_order():
    def state(prefix, x):
        position = {f"{prefix}tcp_position": np.array([x, 0.0, 0.1]), f"{prefix}finger_positions": np.full(2, 0.04)}
        return position | {f"{prefix}tcp_quaternion": np.array([1.0, 0.0, 0.0, 0.0])}

    first, second = state("", 0.4), state("second_", 0.5)
    seen = proprioception(first | second)
    assert np.array_equal(seen, [*proprioception(first), *proprioception(state("", 0.5))])
    assert [Observation({}, numbers, "").action_dim for numbers in (seen[:8], seen)] == [7, 14]
