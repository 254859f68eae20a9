"""Motion primitives that the scripted oracles share. Base frame, metres, radians."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray

OPEN, CLOSED = -1.0, 1.0
State = Mapping[str, FloatArray]


class Script(Protocol):
    """Plays one episode of one task: asked before every control step, answers with one action (7,)."""

    def __call__(self, state: State) -> FloatArray:
        """The next action for this privileged state."""


def move(
    state: State,
    target: FloatArray,
    *,
    gripper: float,
    max_step: float,
    gain: float = 1.0,
    rotation: Rotation | None = None,
    max_turn: float = 0.1,
) -> FloatArray:
    """One action (7,) towards a pose of the tool centre point.

    Args:
        state: Privileged state with `tcp_position` and `tcp_quaternion`.
        target: Position to approach (3,), m.
        gripper: -1 open .. +1 closed.
        max_step: Longest translation in this step (m); the direction is kept.
        gain: Share of the remaining way to command.
        rotation: Orientation to approach, or None to command no rotation.
        max_turn: Largest rotation in this step (rad); the axis is kept.
    """
    action = np.zeros(7)
    action[:3] = limit(gain * (np.asarray(target) - state["tcp_position"]), max_step)
    if rotation is not None:
        error = rotation * Rotation.from_quat(state["tcp_quaternion"]).inv()
        action[3:6] = limit(gain * error.as_rotvec(), max_turn)
    action[6] = gripper
    return action


def limit(vector: FloatArray, length: float) -> FloatArray:
    """The vector, shortened to `length` if it is longer."""
    norm = float(np.linalg.norm(vector))
    return vector if norm <= length else vector * (length / norm)


def distance(state: State, target: FloatArray, *, axes: slice = slice(0, 3)) -> float:
    """How far the tool centre point is from `target` (m), along the chosen axes."""
    return float(np.linalg.norm((np.asarray(target) - state["tcp_position"])[axes]))


def yaw_of(quaternion: FloatArray) -> float:
    """Rotation about the vertical (rad) of an object that stands upright, quaternion xyzw."""
    return float(Rotation.from_quat(quaternion).as_euler("zyx")[0])


def pointing_down(yaw: float) -> Rotation:
    """The orientation of a gripper that points down, turned by `yaw` (rad) about the vertical."""
    return Rotation.from_euler("z", yaw) * Rotation.from_euler("x", np.pi)
