"""Motion primitives of the scripted oracles. Base frame, metres, radians."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray

OPEN, CLOSED = -1.0, 1.0
State = Mapping[str, FloatArray]


class Script(Protocol):
    """Controls one episode of one task; called before every control step."""

    def __call__(self, state: State) -> FloatArray:
        """Return the next action (7,) for a privileged state."""


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
    """Return one action (7,) towards a pose of the tool centre point.

    Args:
        state: Privileged state with `tcp_position` and `tcp_quaternion`.
        target: Position to approach (3,), m.
        gripper: -1 open .. +1 closed.
        max_step: Longest translation in this step (m); the direction is kept.
        gain: Commanded share of the remaining distance and rotation.
        rotation: Orientation to approach, or None for no rotation.
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
    """Return the vector, shortened to `length` if it is longer."""
    norm = float(np.linalg.norm(vector))
    return vector if norm <= length else vector * (length / norm)


def distance(state: State, target: FloatArray, *, axes: slice = slice(0, 3)) -> float:
    """Return the distance of the tool centre point from `target` (m), along the chosen axes."""
    return float(np.linalg.norm((np.asarray(target) - state["tcp_position"])[axes]))


def yaw_of(quaternion: FloatArray) -> float:
    """Return the rotation about the vertical (rad) of an upright object, quaternion xyzw."""
    return float(Rotation.from_quat(quaternion).as_euler("zyx")[0])


def pointing_down(yaw: float) -> Rotation:
    """Return the orientation of a gripper that points down, turned by `yaw` (rad) about the vertical."""
    return Rotation.from_euler("z", yaw) * Rotation.from_euler("x", np.pi)
