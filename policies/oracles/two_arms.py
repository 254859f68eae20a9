"""Scripted oracles of two arms. Each depends on the state alone, so it recovers from any disturbance."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import ARMS, FloatArray
from robogauntlet.policies.oracles.motion import (
    CLOSED,
    OPEN,
    Script,
    State,
    distance,
    move,
    pointing_down,
    yaw_of,
)

MAX_STEP, MAX_TURN, GAIN = 0.0153, 0.153, 0.306
"""Largest motion in one step (m, rad), the limit of robosuite's controller, and the share of the remaining distance."""
UP = np.array([0.0, 0.0, 1.0])


class TwoArmLift:
    """Grasps a handle of the pot with each arm, and lifts both together."""

    bar = 0.02
    """Thickness of a handle (m)."""
    farthest_turn = 1.75
    """Largest yaw of a gripper (rad), within the range of its last joint."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (14,)."""
        arms = [seen_by(arm, state) for arm in ARMS]
        handles = ("handle0", "handle1")
        held = [self._holds(own, handle) for own, handle in zip(arms, handles, strict=True)]
        heights = [state[f"{handle}_position"][2] for handle in handles]
        actions = []
        for own, handle, height in zip(arms, handles, heights, strict=True):
            rotation = pointing_down(self._yaw(own, handle))
            if all(held):
                # The lower side first, so that the pot stays level.
                rise = 0.05 - 4.0 * (height - min(heights))
                actions.append(go(own, own["tcp_position"] + rise * UP, CLOSED, rotation))
            else:
                actions.append(self._grasp(own, handle, rotation))
        return np.concatenate(actions)

    def _yaw(self, own: State, handle: str) -> float:
        """The nearest yaw at which the fingers close across the handle."""
        now = yaw_of((Rotation.from_quat(own["tcp_quaternion"]) * Rotation.from_euler("x", np.pi)).as_quat())
        yaw = yaw_of(own[f"{handle}_quaternion"])
        possible = [y for k in range(-2, 3) if abs(y := yaw + k * np.pi) <= self.farthest_turn]
        return min(possible, key=lambda y: abs(y - now))

    def _holds(self, own: State, handle: str) -> bool:
        opening = float(own["finger_positions"].sum())
        return distance(own, own[f"{handle}_position"]) < 0.03 and 0.5 * self.bar < opening < 1.4 * self.bar

    def _grasp(self, own: State, handle: str, rotation: Rotation) -> FloatArray:
        """Open, approach the handle from above within a funnel, close."""
        target, opening = own[f"{handle}_position"].copy(), float(own["finger_positions"].sum())
        lateral, far = distance(own, target, axes=slice(0, 2)), distance(own, target)
        turn = (rotation * Rotation.from_quat(own["tcp_quaternion"]).inv()).magnitude()
        if (far < 0.025 and 0.5 * self.bar < opening < 0.07) or (far < 0.012 and turn < 0.2):
            return go(own, target, CLOSED, rotation)
        until_open = 0.08 if opening < 0.06 else 0.0
        target[2] += min(0.08, max(0.0, 5.0 * (lateral - 0.01), 0.4 * (turn - 0.15), until_open))
        return go(own, target, OPEN, rotation)


def seen_by(arm: str, state: State) -> State:
    """Return the state for one of `ARMS`: its own entries without the prefix, and handles in the frame of its base."""
    own = {name: state[arm + name] for name in ("tcp_position", "tcp_quaternion", "finger_positions")}
    origin, turn = np.zeros(3), Rotation.identity()
    if arm:
        origin, turn = state[f"{arm}base_position"], Rotation.from_quat(state[f"{arm}base_quaternion"]).inv()
    for handle in ("handle0", "handle1"):
        own[f"{handle}_position"] = turn.apply(state[f"{handle}_position"] - origin)
        own[f"{handle}_quaternion"] = (turn * Rotation.from_quat(state[f"{handle}_quaternion"])).as_quat()
    return own


def go(state: State, target: FloatArray, gripper: float, rotation: Rotation) -> FloatArray:
    """Return one arm's action (7,) towards a pose, within these oracles' limits."""
    return move(state, target, gripper=gripper, max_step=MAX_STEP, gain=GAIN, rotation=rotation, max_turn=MAX_TURN)


SCRIPTS: Mapping[str, Callable[[], Script]] = {"robosuite/TwoArmLift@TwoPandas": TwoArmLift}
