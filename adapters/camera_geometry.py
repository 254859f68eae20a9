"""Geometry of moving cameras, the same for every simulator. Metres, radians, the frame of the camera's carrier."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.scene_control import Viewpoint

UP = np.array([0.0, 0.0, 1.0])


def looking_at(position: FloatArray, target: FloatArray, fovy: float, up: FloatArray = UP) -> Viewpoint:
    """Return a viewpoint at a position (3,), aimed at a target (3,), with `up` (3,) upwards in the image."""
    forward = np.asarray(target, dtype=np.float64) - position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    return Viewpoint(np.asarray(position, dtype=np.float64), rotation, fovy)


def aim_point(viewpoint: Viewpoint, height: float) -> FloatArray:
    """Return the point (3,) where the optical axis of a camera that looks down meets a horizontal plane."""
    forward = viewpoint.rotation[:, 2]
    return viewpoint.position + forward * (height - viewpoint.position[2]) / forward[2]


def orbit(viewpoint: Viewpoint, centre: FloatArray, azimuth: float, elevation: float) -> Viewpoint:
    """Rotate a viewpoint, aimed at a centre (3,) with an upright image, around that centre.

    The rotation is about the vertical, anticlockwise seen from above, and then upwards (rad).
    """
    from scipy.spatial.transform import Rotation  # slow, and not every worker needs it

    turned = Rotation.from_rotvec(azimuth * UP).apply(viewpoint.position - centre)
    sideways = np.cross(UP, turned)
    raised = Rotation.from_rotvec(-elevation * sideways / np.linalg.norm(sideways)).apply(turned)
    return looking_at(centre + raised, centre, viewpoint.fovy)


def move_away(viewpoint: Viewpoint, centre: FloatArray, factor: float) -> Viewpoint:
    """Multiply the distance of a viewpoint from a centre (3,) by a factor."""
    return replace(viewpoint, position=centre + factor * (viewpoint.position - centre))


def widen(viewpoint: Viewpoint, angle: float) -> Viewpoint:
    """Widen the vertical field of view by an angle."""
    return replace(viewpoint, fovy=viewpoint.fovy + angle)


def bump(viewpoint: Viewpoint, offset: FloatArray, turn: FloatArray) -> Viewpoint:
    """Move a viewpoint by an offset (3,) and rotate it by a rotation vector (3,), both in the carrier's frame."""
    from scipy.spatial.transform import Rotation  # slow, and not every worker needs it

    rotation = Rotation.from_rotvec(turn).as_matrix() @ viewpoint.rotation
    return replace(viewpoint, position=viewpoint.position + offset, rotation=rotation)


def azimuth_between(centre: FloatArray, one: Viewpoint, other: Viewpoint) -> float:
    """Return the angle between two viewpoints about the vertical through a centre (3,), from 0 to pi."""
    a, b = ((viewpoint.position - centre)[:2] for viewpoint in (one, other))
    return float(abs(math.atan2(a[0] * b[1] - a[1] * b[0], a @ b)))


def rotation_between(one: Viewpoint, other: Viewpoint) -> float:
    """Return the angle of the rotation between two viewpoints, from 0 to pi."""
    from scipy.spatial.transform import Rotation  # slow, and not every worker needs it

    return float(Rotation.from_matrix(one.rotation.T @ other.rotation).magnitude())
