"""Scripted oracles of two arms. Each depends on the state alone, so it recovers from any disturbance."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import ARM_PREFIXES, FloatArray
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
        handles = ("handle0", "handle1")
        arms = [seen_by(arm, state, handles) for arm in ARM_PREFIXES]
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


class HandOver:
    """The first arm puts the cube down between the arms and withdraws, the second takes it to the goal.

    The place between them is at the limit of their reach: the farther out, the more a gripper leans forward.
    """

    edge = 0.04
    """Of the cube (m)."""
    middle = np.array([0.75, 0.0, 0.02])
    """Where the cube is handed over, in the frame of either base."""
    reached = 0.73
    """Distance from the first base beyond which the cube is the second arm's (m)."""
    aside = np.array([0.52, 0.0, 0.25])
    """Where an arm is out of the other's way, in the frame of its own base (m)."""
    clear = 0.63
    """Distance of the first tool from its base below which it is out of the way (m)."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (14,)."""
        first, second = (seen_by(arm, state, ("cube", "goal")) for arm in ARM_PREFIXES)
        cube = first["cube_position"]
        if self._holds(second):
            return np.concatenate([self._withdraw(first), self._to(second, second["goal_position"], CLOSED)])
        if self._holds(first):
            offset = self.middle - cube
            arrived = bool(np.linalg.norm(offset[:2]) < 0.012 and abs(offset[2]) < 0.006)
            return np.concatenate([self._put(first, arrived), self._to(second, self.aside, OPEN)])
        if cube[0] < self.reached:
            return np.concatenate([self._grasp(first), self._to(second, self.aside, OPEN)])
        waits = first["tcp_position"][0] > self.clear
        taking = self._to(second, self.aside, OPEN) if waits else self._grasp(second)
        return np.concatenate([self._withdraw(first), taking])

    def _holds(self, own: State) -> bool:
        opening = float(own["finger_positions"].sum())
        return distance(own, own["cube_position"]) < 0.025 and abs(opening - self.edge) < 0.006

    def _put(self, own: State, arrived: bool) -> FloatArray:
        """Carry the cube to the middle, a little above the table, and let it go there."""
        tool, offset = own["tcp_position"], self.middle - own["cube_position"]
        if arrived:
            return self._to(own, tool, OPEN)
        offset[2] += min(0.04, 4.0 * max(0.0, float(np.linalg.norm(offset[:2])) - 0.01))
        return self._to(own, tool + offset, CLOSED)

    def _withdraw(self, own: State) -> FloatArray:
        """Open the fingers, rise, and move back."""
        tool = own["tcp_position"]
        if float(own["finger_positions"].sum()) < self.edge + 0.02 and distance(own, own["cube_position"]) < 0.05:
            return self._to(own, tool, OPEN)
        beside = distance(own, own["cube_position"], axes=slice(0, 2)) < 0.06
        return self._to(own, np.array([*tool[:2], 0.2]) if beside and tool[2] < 0.12 else self.aside, OPEN)

    def _grasp(self, own: State) -> FloatArray:
        """Open, approach the cube from above within a funnel, close."""
        cube, tool = own["cube_position"], own["tcp_position"]
        quarter = np.pi / 2
        yaw = (yaw_of(own["cube_quaternion"]) + quarter / 2) % quarter - quarter / 2
        turn = (self._leaning(own, yaw) * Rotation.from_quat(own["tcp_quaternion"]).inv()).magnitude()
        if distance(own, cube) < 0.013 and turn < 0.12:
            return self._to(own, cube, CLOSED, yaw)
        offset = cube - tool
        lateral = float(np.linalg.norm(offset[:2])) + 0.1 * max(0.0, turn - 0.1)
        offset[2] += min(0.07, 4.0 * max(0.0, lateral - 0.01))
        offset[:2] *= np.clip(1.5 - offset[2] / 0.03, 0.0, 1.0)  # Up before across.
        return self._to(own, tool + offset, OPEN, yaw)

    def _to(self, own: State, target: FloatArray, gripper: float, yaw: float = 0.0) -> FloatArray:
        rotation = self._leaning(own, yaw)
        return move(own, target, gripper=gripper, max_step=0.03, gain=0.6, rotation=rotation, max_turn=0.039)

    @staticmethod
    def _leaning(own: State, yaw: float) -> Rotation:
        lean = float(np.clip(3.0 * (own["tcp_position"][0] - 0.6), 0.0, 0.45))
        return Rotation.from_euler("y", -lean) * pointing_down(yaw)


def seen_by(arm: str, state: State, things: Sequence[str]) -> State:
    """Return the state as one arm sees it: its own entries without the prefix, and things in the frame of its base.

    `arm` is one of `ARM_PREFIXES`; `things` are the names of what has a position, and may have a quaternion.
    """
    own = {name: state[arm + name] for name in ("tcp_position", "tcp_quaternion", "finger_positions")}
    origin, turn = np.zeros(3), Rotation.identity()
    if arm:
        origin, turn = state[f"{arm}base_position"], Rotation.from_quat(state[f"{arm}base_quaternion"]).inv()
    for thing in things:
        own[f"{thing}_position"] = turn.apply(state[f"{thing}_position"] - origin)
        if f"{thing}_quaternion" in state:
            own[f"{thing}_quaternion"] = (turn * Rotation.from_quat(state[f"{thing}_quaternion"])).as_quat()
    return own


def go(state: State, target: FloatArray, gripper: float, rotation: Rotation) -> FloatArray:
    """Return one arm's action (7,) towards a pose, within these oracles' limits."""
    return move(state, target, gripper=gripper, max_step=MAX_STEP, gain=GAIN, rotation=rotation, max_turn=MAX_TURN)


SCRIPTS: Mapping[str, Callable[[], Script]] = {
    "robosuite/TwoArmLift@TwoPandas": TwoArmLift,
    "maniskill/TwoRobotPickCube-v1@TwoPandas": HandOver,
}
