"""Scripted oracles of ALOHA's two arms. Each depends on the state alone, so it recovers from any disturbance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import ARM_PREFIXES, FloatArray
from robogauntlet.policies.oracles.joints import ByJoints
from robogauntlet.policies.oracles.motion import CLOSED, OPEN, Script, State, distance, move, pointing_down, yaw_of
from robogauntlet.policies.oracles.two_arms import seen_by

AHEAD, UP = np.eye(3)[[0, 2]]
DOWN = pointing_down(0.0)
SIDEWAYS = Rotation.from_matrix([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""Gripper that points forwards; its fingers open to the sides."""
UPRIGHT = Rotation.from_euler("x", np.pi / 2) * SIDEWAYS
"""The same, fingers one above the other."""
LOWEST = np.array([-np.inf, -np.inf, 0.018])
"""Place of the tool whose fingertips are just above the table (m)."""
HEIGHT = 0.15
"""Of the place between the arms at which they meet (m)."""
MIDDLE = 0.469
"""Distance of that place from either base (m)."""


def go(own: State, target: FloatArray, gripper: float, rotation: Rotation, longest: float = 0.012) -> FloatArray:
    """Return an arm's action (7,) towards a pose of the tool, in steps of a length (m)."""
    return move(own, target, gripper=gripper, max_step=longest, gain=0.35, rotation=rotation, max_turn=0.08)


def holds(own: State, thing: str, width: float) -> bool:
    """Return whether the fingers are closed on a thing of this width (m)."""
    opening = float(own["finger_positions"].sum())
    return distance(own, own[f"{thing}_position"]) < 0.025 and 0.5 * width < opening < width + 0.004


def grasp(own: State, thing: str, rotation: Rotation) -> FloatArray:
    """Return an arm's action (7,): open, come down on the thing within a funnel, close."""
    place, opening = np.maximum(own[f"{thing}_position"], LOWEST), float(own["finger_positions"].sum())
    aside, far = distance(own, place, axes=slice(0, 2)), distance(own, place)
    turn = float((rotation * Rotation.from_quat(own["tcp_quaternion"]).inv()).magnitude())
    if far < (0.008 if opening > 0.06 else 0.016) and turn < 0.15:
        return go(own, place, CLOSED, rotation)
    height = max(5.0 * (aside - 0.006), 0.4 * (turn - 0.1), 0.0 if opening > 0.06 else 0.06)
    return go(own, place + min(0.08, max(0.0, height)) * UP, OPEN, rotation)


class TransferCube:
    """The right arm lifts the cube to the middle from above, and the left one grasps it there from its side."""

    width = 0.04
    """Of the cube (m)."""
    aside = np.array([0.3, 0.0, HEIGHT])
    """Where the left arm waits (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (14,)."""
        left, right = (seen_by(arm, state, ("cube",)) for arm in ARM_PREFIXES)
        cube, meeting = right["cube_position"], np.array([MIDDLE, 0.0, HEIGHT])
        waiting = go(left, self.aside, OPEN, UPRIGHT)
        quarter = np.pi / 2
        yaw = (yaw_of(right["cube_quaternion"]) + quarter / 2) % quarter - quarter / 2
        if not holds(right, "cube", self.width):
            return np.concatenate([waiting, grasp(right, "cube", pointing_down(yaw))])
        if cube[2] < 0.06:  # Up before across.
            meeting[:2] = right["tcp_position"][:2]
        lifting = go(right, meeting, CLOSED, DOWN)
        if distance(right, meeting) > 0.015 or cube[2] < 0.06:
            return np.concatenate([waiting, lifting])
        place, offset = left["cube_position"], left["cube_position"] - left["tcp_position"]
        if offset[0] > 0.02 and np.linalg.norm(offset[1:]) > 0.008:  # Beside it first.
            return np.concatenate([go(left, place * [0.0, 1.0, 1.0] + [self.aside[0], 0, 0], OPEN, UPRIGHT), lifting])
        gripper = CLOSED if np.linalg.norm(offset) < 0.01 else OPEN
        return np.concatenate([go(left, place, gripper, UPRIGHT), lifting])


class Insertion:
    """Each arm lifts its part from above to the middle, and the right one pushes the peg into the socket."""

    widths: Mapping[str, float] = {"socket": 0.044, "peg": 0.02}
    """Of the parts where the fingers close on them, the left arm's first (m)."""
    apart, inside = 0.15, 0.08
    """Distance of the middles of both parts before and after the push (m)."""
    half = 0.06
    """From the peg's middle to its end (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (14,)."""
        arms = [seen_by(arm, state, tuple(self.widths)) for arm in ARM_PREFIXES]
        held = [holds(own, *part) for own, part in zip(arms, self.widths.items(), strict=True)]
        if not all(held):
            parts = zip(arms, self.widths, held, strict=True)
            return np.concatenate([self._take(own, thing, has) for own, thing, has in parts])
        (left, right), raised = arms, min(state["peg_position"][2], state["socket_position"][2]) > 0.06
        socket = np.array([MIDDLE - 0.06, 0.0, HEIGHT])
        axis = Rotation.from_quat(right["peg_quaternion"]).apply(AHEAD)
        end = right["peg_position"] + self.half * np.sign(axis[0]) * axis
        offset = end - right["socket_position"] - self.half * AHEAD
        aside, entering = float(np.linalg.norm(offset[1:])), offset[0] > 0.01 - self.apart
        ready = aside < (0.008 if entering else 0.003)
        way = -(self.inside if ready else self.apart) * AHEAD - offset
        if not raised:
            socket[:2], way = left["tcp_position"][:2], np.array([0.0, 0.0, HEIGHT - right["tcp_position"][2]])
        pushing = go(right, right["tcp_position"] + way, CLOSED, DOWN, 0.003 if ready else 0.006)
        return np.concatenate([go(left, socket, CLOSED, DOWN, 0.006), pushing])

    @staticmethod
    def _take(own: State, thing: str, has: bool) -> FloatArray:
        if has:
            return go(own, own["tcp_position"], CLOSED, DOWN)
        half = np.pi
        yaw = (yaw_of(own[f"{thing}_quaternion"]) + half / 2) % half - half / 2
        return grasp(own, thing, pointing_down(yaw))


SCRIPTS: Mapping[str, Callable[[], Script]] = {
    "gymnasium/AlohaTransferCube-v0": partial(ByJoints, TransferCube),
    "gymnasium/AlohaInsertion-v0": partial(ByJoints, Insertion),
}
