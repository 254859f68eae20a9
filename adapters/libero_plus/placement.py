"""Where LIBERO-Plus puts the camera and the arm. Pure functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw

PIVOT = np.array([0.0, 0.0, 0.8])
"""Point of the world about which the camera is turned (m)."""
DIGITS = 4
"""Decimals to which poses of the camera are rounded after each turn, also those that do not turn."""
POSTURES = 500
STEP = 0.1
"""Distance of the first hundred postures from LIBERO's own (rad); the next hundred are twice as far, and so on."""
SEED = 42
POSTURE_DIGITS = 8


def camera_pose(position: FloatArray, quaternion: FloatArray, view: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Return position (3,) and quaternion wxyz (4,) of the camera of a view.

    Args:
        position: Of LIBERO's own camera in the world, (3,) (m).
        quaternion: Its orientation, wxyz.
        view: Turn about the vertical (deg), turn upwards (deg) and distance (%) with respect to `PIVOT`, then turns of
            the camera in its place about the vertical and upwards (deg).
    """
    around, up, distance, pan, tilt = view
    if up:
        turn = _upwards(up)
        position, quaternion = PIVOT + turn.apply(position - PIVOT), _turned(turn, quaternion)
        position, quaternion = np.round(position, DIGITS), np.round(quaternion, DIGITS)
    turn = _aside(around)
    position, quaternion = np.round(turn.apply(position), DIGITS), np.round(_turned(turn, quaternion), DIGITS)
    if distance != 100:
        position = np.round(PIVOT + (position - PIVOT) * (distance / 100), DIGITS)
    if pan:
        quaternion = np.round(_turned(_aside(pan), quaternion), DIGITS)
    if tilt:
        quaternion = np.round(_turned(_upwards(tilt), quaternion), DIGITS)
    return position, quaternion / np.linalg.norm(quaternion)


@cache
def postures() -> FloatArray:
    """Return the offsets of the arm's joints, (501, 7) (rad); the first is zero.

    LIBERO-Plus lists 500 of them, which are random directions of five lengths: this draws the same.
    """
    directions = np.random.RandomState(SEED).randn(POSTURES, 7)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lengths = STEP * (1 + np.arange(POSTURES) // 100)
    return np.vstack([np.zeros(7), directions * lengths[:, None]])


def posture(own: FloatArray, number: int) -> FloatArray:
    """Return the joint positions (7,) of a posture, from LIBERO's own (rad)."""
    return np.round(own + postures()[number], POSTURE_DIGITS) if number else own


def turn_between(one: FloatArray, other: FloatArray) -> float:
    """Return the angle between two orientations, quaternions wxyz (deg)."""
    turn = Rotation.from_quat(wxyz_to_xyzw(one)).inv() * Rotation.from_quat(wxyz_to_xyzw(other))
    return math.degrees(turn.magnitude())


def _aside(angle: float) -> Rotation:
    return Rotation.from_euler("z", angle, degrees=True)


def _upwards(angle: float) -> Rotation:
    return Rotation.from_euler("y", -angle, degrees=True)


def _turned(turn: Rotation, quaternion: FloatArray) -> FloatArray:
    return np.roll((turn * Rotation.from_quat(wxyz_to_xyzw(quaternion))).as_quat(), 1)
