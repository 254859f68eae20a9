"""Scripted oracles for ManiSkill. Each depends on the state alone, so it recovers from any disturbance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, distance, move, pointing_down, yaw_of

STEP = 0.03
"""Longest translation in one control step (m)."""
TURN = 0.039
"""Largest rotation in one control step (rad), the controller's limit."""
GAIN = 0.6
REST_YAW = np.pi / 2
"""The gripper's rotation about the vertical in ManiSkill's rest pose (rad)."""
CUBE = 0.04
"""Edge of every cube (m)."""
XY = slice(0, 2)


class Push:
    """Pushes the cube onto the goal with closed fingers, from behind and slowly enough that it stops with them.

    The goal is at the limit of the arm's reach: the farther out, the more the gripper leans forward.
    """

    standoff = 0.055
    """Distance between the centres of cube and gripper before the push (m)."""
    slack = 0.015
    """Largest distance of the gripper from the line from cube to goal while it pushes (m)."""
    max_step = 0.014
    """Longest translation in one step of the push (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        cube, tcp = state["cube_position"], state["tcp_position"]
        direction, remaining = _to_goal(state)
        lean = float(np.clip(3.0 * (tcp[0] - 0.6), 0.0, 0.45))
        along = float((tcp - cube) @ direction)
        lateral = float(np.linalg.norm((tcp - cube - along * direction)[XY]))
        if tcp[2] < CUBE and lateral < self.slack and -1.6 * self.standoff < along < 0:
            target = cube + direction * (min(remaining, STEP) - CUBE / 2)
            return _move(state, target, gripper=CLOSED, max_step=self.max_step, lean=lean)
        return _hover(state, cube - direction * self.standoff, clearance=0.08, gripper=CLOSED, lean=lean)


class Pull:
    """Lowers the open fingers in front of and behind the cube, and pulls it onto the goal.

    In the rest pose the fingers open in the direction of the goal.
    """

    lead = 0.01
    """Distance ahead of the cube's centre, towards the goal, at which the gripper moves down (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        cube = state["cube_position"]
        direction, remaining = _to_goal(state)
        if distance(state, cube, axes=XY) < 0.035 and state["tcp_position"][2] < CUBE:
            return _move(state, cube + direction * (CUBE / 2 + min(remaining, 2 * STEP)), gripper=OPEN)
        return _hover(state, cube + direction * self.lead, clearance=0.06, gripper=OPEN)


class Stack:
    """Grasps the red cube across two faces, moves it over the green one and releases it."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,)."""
        tcp, red, green = state["tcp_position"], state["red_cube_position"], state["green_cube_position"]
        gripper = Rotation.from_quat(state["tcp_quaternion"])
        opening = float(state["finger_positions"].sum())
        to_place = green - red + np.array([0.0, 0.0, CUBE])
        if np.linalg.norm(to_place[XY]) < 0.015 and abs(to_place[2]) < 0.003:
            retreat = [0.0, 0.0, STEP if opening > CUBE + 0.02 else 0.0]
            return _move(state, tcp + retreat, gripper=OPEN, yaw=_yaw(gripper))
        if distance(state, red) < 0.025 and abs(opening - CUBE) < 0.004:
            return _hover(state, tcp + to_place, clearance=0.05, gripper=CLOSED, yaw=_yaw(gripper))
        yaw = _grasp_yaw(state["red_cube_quaternion"], green - red)
        to_turn = float((pointing_down(yaw) * gripper.inv()).magnitude())
        if distance(state, red) < 0.013 and to_turn < 0.1:
            return _move(state, red, gripper=CLOSED, yaw=yaw)
        return _hover(state, red, clearance=0.07, gripper=OPEN, yaw=yaw, to_turn=to_turn)


def _to_goal(state: State) -> tuple[FloatArray, float]:
    """Return the horizontal direction (3,) from cube to goal, and the distance (m)."""
    offset = (state["goal_position"] - state["cube_position"]) * [1.0, 1.0, 0.0]
    remaining = float(np.linalg.norm(offset))
    return offset / max(remaining, 1e-6), remaining


def _move(
    state: State,
    target: FloatArray,
    *,
    gripper: float,
    yaw: float = REST_YAW,
    lean: float = 0.0,
    max_step: float = STEP,
) -> FloatArray:
    """Return one action (7,) towards `target`, pointing down except for `lean` (rad), fingers ahead of the hand."""
    rotation = Rotation.from_euler("y", -lean) * pointing_down(yaw)
    return move(state, target, gripper=gripper, max_step=max_step, gain=GAIN, rotation=rotation, max_turn=TURN)


def _hover(
    state: State,
    target: FloatArray,
    *,
    clearance: float,
    gripper: float,
    yaw: float = REST_YAW,
    lean: float = 0.0,
    to_turn: float = 0.0,
) -> FloatArray:
    """Return one action (7,) in a funnel above `target`: the farther or less turned, the higher; up before across."""
    offset = target - state["tcp_position"]
    lateral = float(np.linalg.norm(offset[XY])) + 0.1 * max(0.0, to_turn - 0.05)
    offset[2] += min(clearance, 4.0 * max(0.0, lateral - 0.01))
    offset[XY] *= np.clip(1.5 - offset[2] / 0.03, 0.0, 1.0)
    return _move(state, state["tcp_position"] + offset, gripper=gripper, yaw=yaw, lean=lean)


def _yaw(gripper: Rotation) -> float:
    """Return the yaw (rad) for which `pointing_down` is closest to the gripper's orientation."""
    return yaw_of((gripper * pointing_down(0.0).inv()).as_quat())


def _grasp_yaw(quaternion: FloatArray, neighbour: FloatArray) -> float:
    """Return the gripper's yaw (rad) to grasp a cube across two faces.

    Of the two within a right angle of the rest pose, it is the nearer one, unless the fingers would hit another cube,
    whose centre is at `neighbour` relative to this one's (m).
    """
    near = REST_YAW + (yaw_of(quaternion) - REST_YAW + np.pi / 4) % (np.pi / 2) - np.pi / 4
    far = near - np.copysign(np.pi / 2, near - REST_YAW)
    if np.linalg.norm(neighbour[XY]) > 0.11:
        return float(near)
    # The fingers open along the gripper's y axis, at a right angle to its yaw.
    away = np.arctan2(neighbour[1], neighbour[0])
    return float(min((near, far), key=lambda yaw: abs(np.sin(yaw - away))))


SCRIPTS: dict[str, Callable[[], Script]] = {
    "maniskill/PushCube-v1": Push,
    "maniskill/PullCube-v1": Pull,
    "maniskill/StackCube-v1": Stack,
}
