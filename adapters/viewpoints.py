"""Moving cameras: pure geometry, alike for every simulator. Metres, radians, the frame of the camera's carrier."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.adjusting import Viewpoint
from adapters.contract import FloatArray

UP = np.array([0.0, 0.0, 1.0])


def looking_at(position: FloatArray, target: FloatArray, fovy: float, up: FloatArray = UP) -> Viewpoint:
    """A viewpoint from a position (3,) towards a target (3,), with `up` (3,) upwards in the image."""
    forward = np.asarray(target, dtype=np.float64) - position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    return Viewpoint(np.asarray(position, dtype=np.float64), rotation, fovy)


def seen_at_height(viewpoint: Viewpoint, height: float) -> FloatArray:
    """The point (3,) where the optical axis meets a horizontal plane: what a camera that looks down is aimed at."""
    forward = viewpoint.rotation[:, 2]
    return viewpoint.position + forward * (height - viewpoint.position[2]) / forward[2]


def orbited(viewpoint: Viewpoint, centre: FloatArray, azimuth: float, elevation: float) -> Viewpoint:
    """The viewpoint carried round a centre (3,), about the vertical and then upwards, still aimed as it was.

    Args:
        viewpoint: Of a camera whose optical axis passes through the centre and whose image is upright.
        centre: What it goes round.
        azimuth: Anticlockwise seen from above.
        elevation: Upwards.
    """
    turned = Rotation.from_rotvec(azimuth * UP).apply(viewpoint.position - centre)
    sideways = np.cross(UP, turned)
    raised = Rotation.from_rotvec(-elevation * sideways / np.linalg.norm(sideways)).apply(turned)
    return looking_at(centre + raised, centre, viewpoint.fovy)


def farther(viewpoint: Viewpoint, centre: FloatArray, factor: float) -> Viewpoint:
    """The viewpoint at so many times the distance from a centre (3,), aimed as it was."""
    return replace(viewpoint, position=centre + factor * (viewpoint.position - centre))


def widened(viewpoint: Viewpoint, angle: float) -> Viewpoint:
    """The viewpoint with a vertical field of view that is wider by an angle."""
    return replace(viewpoint, fovy=viewpoint.fovy + angle)


def bumped(viewpoint: Viewpoint, offset: FloatArray, turn: FloatArray) -> Viewpoint:
    """The viewpoint moved by an offset (3,) and turned by a rotation vector (3,), both in the carrier's frame."""
    rotation = Rotation.from_rotvec(turn).as_matrix() @ viewpoint.rotation
    return replace(viewpoint, position=viewpoint.position + offset, rotation=rotation)


def angle_round(centre: FloatArray, one: Viewpoint, other: Viewpoint) -> float:
    """Angle about the vertical through a centre (3,) between two viewpoints, from 0 to pi."""
    a, b = ((viewpoint.position - centre)[:2] for viewpoint in (one, other))
    return float(abs(math.atan2(a[0] * b[1] - a[1] * b[0], a @ b)))


def turn_between(one: Viewpoint, other: Viewpoint) -> float:
    """Angle by which one viewpoint is turned against the other, from 0 to pi."""
    return float(Rotation.from_matrix(one.rotation.T @ other.rotation).magnitude())
