"""What the scripted oracles for ManiSkill have in common: the arm's limits, and motions of its gripper."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, State, distance, move, pointing_down, yaw_of

STEP = 0.03
"""Longest translation in one control step (m)."""
TURN = 0.039
"""Largest rotation in one control step (rad), the controller's limit."""
GAIN = 0.6
REST_YAW = np.pi / 2
"""The gripper's rotation about the vertical in the rest pose of most tasks of one arm (rad)."""
CUBE = 0.04
"""Edge of every cube (m)."""
XY = slice(0, 2)


def holds(state: State, place: FloatArray, *, width: float = CUBE, slack: float = 0.004) -> bool:
    """Return whether the fingers hold something so wide, within `slack` (m), at a place."""
    return distance(state, place) < 0.025 and abs(float(state["finger_positions"].sum()) - width) < slack


def grasp(state: State, place: FloatArray, yaw: float, *, lean: float = 0.0) -> FloatArray:
    """Return one action (7,) of a grasp: open, approach the place from above, close."""
    return grasp_turned(state, place, leaning(yaw, lean))


def grasp_turned(state: State, place: FloatArray, rotation: Rotation) -> FloatArray:
    """Return one action (7,) of a grasp with the gripper in this orientation: open, approach from above, close."""
    to_turn = float((rotation * Rotation.from_quat(state["tcp_quaternion"]).inv()).magnitude())
    if distance(state, place) < 0.013 and to_turn < 0.1:
        return go_turned(state, place, rotation, gripper=CLOSED)
    return go_turned(state, funnel(state, place, clearance=0.07, to_turn=to_turn), rotation, gripper=OPEN)


def let_go(state: State) -> FloatArray:
    """Return one action (7,) that opens the fingers, and then withdraws them upwards."""
    yaw = tool_yaw(state)
    retreat = [0.0, 0.0, STEP if float(state["finger_positions"].sum()) > CUBE + 0.02 else 0.0]
    return go(state, state["tcp_position"] + retreat, gripper=OPEN, yaw=yaw)


def to_goal(state: State, name: str = "cube") -> tuple[FloatArray, float]:
    """Return the horizontal direction (3,) from an object to the goal, and the distance (m)."""
    offset = (state["goal_position"] - state[f"{name}_position"]) * [1.0, 1.0, 0.0]
    remaining = float(np.linalg.norm(offset))
    return offset / max(remaining, 1e-6), remaining


def go(
    state: State,
    target: FloatArray,
    *,
    gripper: float,
    yaw: float = REST_YAW,
    lean: float = 0.0,
    max_step: float = STEP,
) -> FloatArray:
    """Return one action (7,) towards `target`, pointing down except for `lean` (rad), fingers ahead of the hand."""
    return go_turned(state, target, leaning(yaw, lean), gripper=gripper, max_step=max_step)


def go_turned(
    state: State, target: FloatArray, rotation: Rotation, *, gripper: float, max_step: float = STEP
) -> FloatArray:
    """Return one action (7,) towards a pose of the gripper."""
    return move(state, target, gripper=gripper, max_step=max_step, gain=GAIN, rotation=rotation, max_turn=TURN)


def leaning(yaw: float, lean: float) -> Rotation:
    """Return the orientation of a gripper that points down except for `lean` (rad), fingers ahead of the hand."""
    return Rotation.from_euler("y", -lean) * pointing_down(yaw)


def lean_at(state: State) -> float:
    """Return how much the gripper has to lean (rad) where it is: at the limit of reach it cannot point down."""
    return float(np.clip(3.0 * (state["tcp_position"][0] - 0.6), 0.0, 0.45))


def hover(
    state: State,
    target: FloatArray,
    *,
    clearance: float,
    gripper: float,
    yaw: float = REST_YAW,
    lean: float = 0.0,
    to_turn: float = 0.0,
) -> FloatArray:
    """Return one action (7,) towards `target` from above, see `funnel`."""
    return go(state, funnel(state, target, clearance=clearance, to_turn=to_turn), gripper=gripper, yaw=yaw, lean=lean)


def funnel(state: State, target: FloatArray, *, clearance: float, to_turn: float = 0.0) -> FloatArray:
    """Return where to go to reach `target` from above: the farther or less turned, the higher; up before across."""
    offset = target - state["tcp_position"]
    lateral = float(np.linalg.norm(offset[XY])) + 0.1 * max(0.0, to_turn - 0.05)
    offset[2] += min(clearance, 4.0 * max(0.0, lateral - 0.01))
    offset[XY] *= np.clip(1.5 - offset[2] / 0.03, 0.0, 1.0)
    return np.asarray(state["tcp_position"] + offset)


def tool_yaw(state: State) -> float:
    """Return the yaw (rad) for which `pointing_down` is closest to the gripper's orientation."""
    return yaw_of((Rotation.from_quat(state["tcp_quaternion"]) * pointing_down(0.0).inv()).as_quat())


def line_yaw(axis: FloatArray) -> float:
    """Return the gripper's yaw (rad) to grasp something long across its horizontal axis, the one nearest to zero."""
    yaw = float(np.arctan2(axis[1], axis[0]))
    return (yaw + np.pi / 2) % np.pi - np.pi / 2


def grasp_yaw(quaternion: FloatArray, neighbour: FloatArray) -> float:
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
