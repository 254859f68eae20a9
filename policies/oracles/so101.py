"""Scripted oracles of the SO-101. Each depends on the state alone, so it recovers from any disturbance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, limit, pointing_down, yaw_of

UP = np.array([0.0, 0.0, 1.0])
HIGH = np.array([1.91986, 1.74533, 1.69, 1.65806, 2.84121])
LOW = np.array([*-HIGH[:4], -2.74385])
"""Limits of the joints (rad)."""
LEVER = 0.04
"""Length by which an angle counts as much as a distance (m): five joints cannot reach every pose."""
DAMPING = 0.02
"""Of the least squares; keeps the joints from racing where the arm is stretched."""
SHARE = 0.25
"""Of the way that is left, for each control step."""
FASTEST = 0.1
"""Largest change of a joint's target in a step (rad)."""


def steer(state: State, target: FloatArray, yaw: float, gripper: float, longest: float = 0.03) -> FloatArray:
    """Return an action (6,) that brings the tool towards a point (3,), pointing down as far as the joints can.

    The targets are moved, not the joints, which gravity bends: so they come to rest where the tool is at the point.
    """
    turn = pointing_down(yaw) * Rotation.from_quat(state["tcp_quaternion"]).inv()
    way = np.concatenate([limit(SHARE * (target - state["tcp_position"]), longest), SHARE * LEVER * turn.as_rotvec()])
    jacobian = state["tcp_jacobian"] * np.repeat([1.0, LEVER], 3)[:, None]
    targets = state["joint_targets"]
    low, high = np.maximum(LOW - targets, -FASTEST), np.minimum(HIGH - targets, FASTEST)
    damped = np.concatenate([jacobian, DAMPING * np.eye(len(targets))])
    change = lsq_linear(damped, np.append(way, np.zeros(len(targets))), (low - 1e-6, high + 1e-6), method="bvls").x
    return np.append(np.clip(targets + change, LOW, HIGH), gripper)


class _Cube:
    """What the scripts have in common: the cube, how to grasp it, and whether it is held."""

    cube = "cube"

    def yaw(self, state: State) -> float:
        """Return the angle about the vertical at which the jaws close on two faces, the nearest to the arm's plane."""
        ahead = float(np.arctan2(*state[f"{self.cube}_position"][1::-1]))
        turned = yaw_of(state[f"{self.cube}_quaternion"]) - ahead
        return ahead + (turned + np.pi / 4) % (np.pi / 2) - np.pi / 4

    def holds(self, state: State) -> bool:
        """Return whether the jaws are closed on the cube."""
        near = np.linalg.norm(state[f"{self.cube}_position"] - state["tcp_position"]) < 0.022
        return bool(near and state["gripper"][0] > 0.38)

    def grasp(self, state: State) -> FloatArray:
        """Open, come down on the cube within a funnel, close."""
        tool, cube, yaw = state["tcp_position"], state[f"{self.cube}_position"], self.yaw(state)
        aside = float(np.linalg.norm((cube - tool)[:2]))
        near = 0.008 if state["gripper"][0] < -0.8 else 0.02
        if aside < near and abs(cube[2] - tool[2]) < near:
            return steer(state, cube, yaw, CLOSED)
        height = min(0.06, max(0.0, 5.0 * (aside - 0.006)))
        return steer(state, cube + height * UP, yaw, OPEN)


class PickPlace(_Cube):
    """Grasps the cube, carries it over the disc, lowers it and lets go."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (6,)."""
        return self.bring(state, state["goal_position"] + 0.015 * UP)

    def bring(self, state: State, aim: FloatArray) -> FloatArray:
        """Bring the cube to a point (3,) and let go of it."""
        tool, cube = state["tcp_position"], state[f"{self.cube}_position"]
        yaw, left = self.yaw(state), aim - cube
        aside = float(np.linalg.norm(left[:2]))
        if aside < 0.012 and left[2] > -0.006:
            return steer(state, tool + 0.03 * UP, yaw, OPEN)
        if not self.holds(state):
            return self.grasp(state)
        lift = min(0.05, max(0.0, 3.0 * (aside - 0.006)))
        way = left + lift * UP
        if way[2] > 0.015:
            way[:2] = 0.0
        return steer(state, tool + way, yaw, CLOSED)


class Stack(PickPlace):
    """Does the same with the red cube, on the green one."""

    cube = "red_cube"

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (6,)."""
        return self.bring(state, state["green_cube_position"] + 0.03 * UP)


class Push(_Cube):
    """Puts the closed jaws behind the cube and pushes it onto the disc."""

    aside = 0.012
    """Distance from the tool centre to where the jaws meet, towards the fixed one (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (6,)."""
        tool, cube = state["tcp_position"], state["cube_position"]
        way = (state["goal_position"] - cube)[:2]
        left, heading = float(np.linalg.norm(way)), float(np.arctan2(way[1], way[0]))
        ahead, across = (
            np.array([np.cos(heading), np.sin(heading), 0.0]),
            np.array([-np.sin(heading), np.cos(heading), 0.0]),
        )
        jaws = tool + self.aside * across
        if left < 0.008:
            return steer(state, tool + 0.03 * UP, heading, CLOSED)
        behind, off = float((cube - jaws) @ ahead), float((cube - jaws) @ across)
        low = tool[2] - cube[2] < 0.012
        if abs(off) < 0.012 and behind > (0.012 if low else 0.03):
            step = (0.0 if not low else min(0.03, left + 0.01) if behind < 0.03 else behind - 0.02) * ahead
            return steer(state, np.append((tool + step + off * across)[:2], cube[2]), heading, CLOSED)
        start = tool + (behind - 0.05) * ahead + off * across
        height = min(0.05, max(0.0, 4.0 * (float(np.linalg.norm((start - tool)[:2])) - 0.006)))
        return steer(state, np.append(start[:2], cube[2] + height), heading, CLOSED)


_BY_NAME: dict[str, Callable[[], Script]] = {"PickPlace": PickPlace, "Push": Push, "Stack": Stack}
SCRIPTS = {f"so101/{name}{end}": script for name, script in _BY_NAME.items() for end in ("", "-other-colours")}
