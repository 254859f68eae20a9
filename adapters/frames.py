"""Rotations, frames and state hashes that adapters share. Pure functions on NumPy arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np

from robogauntlet.adapters.contract import ARM_PREFIXES, FloatArray

STATE_QUANTUM = 1e-6
"""Differences below this (m, rad) do not change a state hash."""


def axis_angle(quaternion: FloatArray) -> FloatArray:
    """Return the axis-angle vector (3,) of a quaternion xyzw (4,), on the branch around (pi, 0, 0).

    A gripper that points down is a half turn, where the usual choice (angle <= pi) jumps between v and -v. The sign of
    the quaternion is therefore chosen by its x component, so the vector is continuous for every pose within a right
    angle of pointing down, and its angle lies in [0, 2 pi).
    """
    q = np.asarray(quaternion, dtype=np.float64)
    return axis_angle_as_signed(-q if q[0] < 0 or (q[0] == 0 and q[3] < 0) else q)


def axis_angle_as_signed(quaternion: FloatArray) -> FloatArray:
    """Return the axis-angle vector (3,) of a quaternion xyzw (4,) of any length, of an angle in [0, 2 pi].

    The sign of the quaternion decides between the two vectors of a rotation, as in robosuite's `quat2axisangle`.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    q = q / np.linalg.norm(q)
    sine = float(np.linalg.norm(q[:3]))
    if sine < 1e-12:
        return np.zeros(3)
    return q[:3] / sine * (2.0 * np.arctan2(sine, q[3]))


def relative_pose(
    base_position: FloatArray, base_quaternion: FloatArray, position: FloatArray, quaternion: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Express a world pose in a base frame. Positions in metres, quaternions xyzw."""
    from scipy.spatial.transform import Rotation  # takes 0.2 s, in commands that hash at most

    inverse = Rotation.from_quat(base_quaternion).inv()
    relative = inverse.apply(np.asarray(position) - np.asarray(base_position))
    return relative, (inverse * Rotation.from_quat(quaternion)).as_quat()


def proprioception(state: Mapping[str, FloatArray], *, of_joints: bool = False) -> FloatArray:
    """Return an observation's proprioception from a privileged state.

    Of each arm tool position, axis-angle and fingers, shape (8 * arms,); or the angles of n joints and the gripper,
    shape ((n + 1) * arms,).
    """
    parts = []
    for arm in ARM_PREFIXES:
        if of_joints and f"{arm}joint_angles" in state:
            parts += [state[f"{arm}joint_angles"], state[f"{arm}gripper"]]
        elif not of_joints and f"{arm}tcp_position" in state:
            position, quaternion = state[f"{arm}tcp_position"], state[f"{arm}tcp_quaternion"]
            parts += [position, axis_angle(quaternion), state[f"{arm}finger_positions"]]
    return np.concatenate(parts)


def wxyz_to_xyzw(quaternion: FloatArray) -> FloatArray:
    """Reorder a quaternion of SAPIEN or MuJoCo."""
    return np.roll(np.asarray(quaternion, dtype=np.float64), -1)


def hash_state(arrays: Mapping[str, FloatArray]) -> str:
    """Hash of named float arrays, quantised to `STATE_QUANTUM`: 16 hexadecimal digits.

    The quantum excludes the last bits, in which processors differ.
    """
    digest = hashlib.sha256()
    for name in sorted(arrays):
        values = np.round(np.asarray(arrays[name], dtype=np.float64).ravel() / STATE_QUANTUM) + 0.0
        digest.update(name.encode())
        digest.update(values.astype("<f8").tobytes())
    return digest.hexdigest()[:16]
