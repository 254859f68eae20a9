"""Scripted oracles for robosuite. Each decides from the state alone what to do next, so it also recovers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, move, pointing_down, yaw_of

MAX_STEP, MAX_TURN = 0.0153, 0.153
"""Longest motion in one step (m, rad): what the controller can do."""
GAIN = 0.306
"""Share of the remaining way in one step: the most that this controller follows without overshooting."""
UP = np.array([0.0, 0.0, 1.0])


class Lift:
    """Grasps the cube and lifts it."""

    def __call__(self, state: State) -> FloatArray:
        """The next action."""
        yaw = grasp_yaw(state, "cube")
        if not holds(state, "cube"):
            return grasp(state, "cube", yaw)
        return go(state, state["tcp_position"] + 0.05 * UP, CLOSED, pointing_down(yaw))


class Stack:
    """Grasps the red cube, carries it over the green one, lowers it and lets go."""

    stacked = 0.045
    """Height of the red cube's centre above the green one's (m)."""

    def __call__(self, state: State) -> FloatArray:
        """The next action."""
        red, green = state["cubeA_position"], state["cubeB_position"]
        rotation = pointing_down(grasp_yaw(state, "cubeA"))
        goal = green + self.stacked * UP
        away = goal - red
        aside = float(np.linalg.norm(away[:2]))
        opening = float(state["finger_positions"].sum())
        if aside < 0.015 and abs(away[2]) < 0.006:
            free = opening > 0.06 or distance_to(state, red) > 0.03
            return go(state, state["tcp_position"] + (0.04 * UP if free else 0.0), OPEN, rotation)
        if not holds(state, "cubeA"):
            return grasp(state, "cubeA", grasp_yaw(state, "cubeA", obstacle=green))
        # Up first, then across, then down a funnel.
        away[2] += min(0.04, max(0.0, 4.0 * (aside - 0.008)))
        away[:2] *= float(np.clip(1.0 - (away[2] - 0.01) / 0.02, 0.0, 1.0))
        return go(state, state["tcp_position"] + away, CLOSED, rotation)


class Door:
    """Grasps the handle, turns it down until the latch is free, and pulls the door open.

    The fingers meet the handle from above and in front, and turn with it: they would slip off if they did not.
    """

    tilt = np.radians(50.0)
    """From pointing down to pointing at the door. The palm is wider than the gap, so straight down it would touch."""
    handle_depth = 0.1
    """From the latch's axis to the middle of the handle, along the door's normal (m)."""
    lever_arm = 0.1
    """From the latch's axis to where the handle is grasped (m)."""
    unlatched = 1.25
    """Angle of the handle (rad) at which pulling starts. The latch clears the frame at 1.2."""

    def __call__(self, state: State) -> FloatArray:
        """The next action."""
        door = Rotation.from_quat(state["door_quaternion"])
        normal = -door.apply([0.0, 1.0, 0.0])
        turned, opened = float(state["latch_angle"][0]), float(state["hinge_angle"][0])
        pivot = state["latch_position"] + self.handle_depth * normal

        def handle(angle: float) -> FloatArray:
            turn = Rotation.from_rotvec(-angle * normal)
            return pivot + self.lever_arm * turn.apply(door.apply([1.0, 0.0, 0.0]))

        facing = Rotation.from_euler("z", yaw_of(state["door_quaternion"]) - np.pi)
        leaning = facing * Rotation.from_euler("x", -self.tilt) * pointing_down(0.0)
        rotation = Rotation.from_rotvec(-turned * normal) * leaning
        pointing = rotation.apply(UP)

        tcp = state["tcp_position"]
        offset = tcp - handle(turned)
        depth = float(offset @ pointing)
        aside = float(np.linalg.norm(offset - depth * pointing))
        askew = (rotation * Rotation.from_quat(state["tcp_quaternion"]).inv()).magnitude()
        opening = float(state["finger_positions"].sum())

        # A handle turned far has the gripper on it, for it springs back; the turn may wedge the fingers open.
        gripped = opening < 0.06 or turned > 0.3
        held = gripped and aside < 0.03 and abs(depth) < 0.03
        hooked = gripped and aside < 0.045 and abs(depth) < 0.045
        if (hooked and opened > 0.02) or (held and turned > self.unlatched):
            return go(state, tcp + 0.05 * normal, CLOSED, rotation)
        if held:
            return go(state, tcp + handle(turned + 0.4) - handle(turned), CLOSED, rotation)
        closing = aside < 0.02 and abs(depth) < 0.02 and opening < 0.07
        if closing or (aside < 0.01 and abs(depth) < 0.015 and askew < 0.2):
            return go(state, handle(turned), CLOSED, rotation)
        shut = 0.1 if opening < 0.06 else 0.0
        back = min(0.1, max(0.0, 4.0 * (aside - 0.008), 0.4 * (askew - 0.15), shut))
        return go(state, handle(turned) - back * pointing, OPEN, rotation)


def go(state: State, target: FloatArray, gripper: float, rotation: Rotation) -> FloatArray:
    """One action towards a pose, at the pace of these oracles."""
    return move(state, target, gripper=gripper, max_step=MAX_STEP, gain=GAIN, rotation=rotation, max_turn=MAX_TURN)


def distance_to(state: State, point: FloatArray) -> float:
    """How far the tool centre point is from `point` (m)."""
    return float(np.linalg.norm(state["tcp_position"] - point))


def tool_yaw(state: State) -> float:
    """Rotation of the downward gripper about the vertical (rad)."""
    return yaw_of((Rotation.from_quat(state["tcp_quaternion"]) * Rotation.from_euler("x", np.pi)).as_quat())


def grasp_yaw(state: State, cube: str, obstacle: FloatArray | None = None) -> float:
    """The nearest yaw at which the fingers meet two faces of the cube, or the next if an obstacle is in their way."""
    now = tool_yaw(state)
    quarter = np.pi / 2
    turn = (yaw_of(state[f"{cube}_quaternion"]) - now + quarter / 2) % quarter - quarter / 2
    if obstacle is not None:
        away = (obstacle - state[f"{cube}_position"])[:2]
        finger_axis = np.array([-np.sin(now + turn), np.cos(now + turn)])
        if np.linalg.norm(away) < 0.1 and abs(finger_axis @ away) > 0.75 * np.linalg.norm(away):
            turn += -quarter if turn > 0 else quarter
    return now + turn


def holds(state: State, cube: str) -> bool:
    """Whether the fingers have closed on the cube."""
    return around(state, cube, 0.02) and 0.03 < float(state["finger_positions"].sum()) < 0.047


def around(state: State, cube: str, slack: float) -> bool:
    """Whether the cube's centre is between the fingers, to within `slack` (m) sideways and in height."""
    offset = state[f"{cube}_position"] - state["tcp_position"]
    return bool(np.linalg.norm(offset[:2]) < slack and abs(offset[2]) < slack)


def grasp(state: State, cube: str, yaw: float) -> FloatArray:
    """One action of opening, coming down on the cube through a funnel, and closing.

    Fingers that are closing go on with less precision than fingers that would start to: else noise stops them halfway.
    """
    target = state[f"{cube}_position"].copy()
    opening = float(state["finger_positions"].sum())
    aside = float(np.linalg.norm((target - state["tcp_position"])[:2]))
    askew = abs(yaw - tool_yaw(state))
    closing = around(state, cube, 0.018) and 0.03 < opening < 0.07
    if closing or (around(state, cube, 0.01) and askew < 0.2 and opening > 0.03):
        return go(state, target, CLOSED, pointing_down(yaw))
    shut = 0.08 if opening < 0.06 else 0.0
    target[2] += min(0.08, max(0.0, 5.0 * (aside - 0.01), 0.4 * (askew - 0.15), shut))
    return go(state, target, OPEN, pointing_down(yaw))


SCRIPTS: dict[str, Callable[[], Script]] = {"robosuite/Lift": Lift, "robosuite/Stack": Stack, "robosuite/Door": Door}
