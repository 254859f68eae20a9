"""The cameras of the PyBullet adapter. PyBullet itself has none: it renders from any pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robogauntlet.adapters.camera_geometry import looking_at
from robogauntlet.adapters.scene_control import Viewpoint


@dataclass(frozen=True)
class Camera:
    """A pinhole camera. Positions in metres, in the base frame, or in the tool's frame for the wrist."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float]
    fovy: float
    """Vertical field of view (degrees)."""


THIRD_PERSON = Camera(eye=(1.28, 0.36, 0.52), target=(0.57, 0.0, 0.12), up=(0.0, 0.0, 1.0), fovy=36.0)
"""In front of the robot and to its left, looking at the workspace and back at the arm."""
WRIST = Camera(eye=(0.08, 0.0, -0.08), target=(0.0, 0.0, 0.04), up=(-1.0, 0.0, 0.0), fovy=75.0)
"""On the front of the hand, looking down between the fingertips. The tool's z axis points out of the gripper."""
CAMERAS = {"third_person": THIRD_PERSON, "wrist": WRIST}


class PyBulletCameras:
    """`Cameras` of `scene_control`."""

    def __init__(self) -> None:
        self._viewpoints: dict[str, Viewpoint] = {}

    def undo(self) -> None:
        """Restore every viewpoint."""
        self._viewpoints.clear()

    def camera(self, name: str) -> Camera:
        """Return the camera to render from, exactly the original if it was not moved."""
        if name not in self._viewpoints:
            return CAMERAS[name]
        viewpoint = self._viewpoints[name]
        _, down, forward = viewpoint.rotation.T
        vectors = (viewpoint.position, viewpoint.position + forward, -down)
        eye, target, up = (tuple(vector.tolist()) for vector in vectors)
        return Camera(eye, target, up, math.degrees(viewpoint.fovy))

    def viewpoint(self, camera: str) -> Viewpoint:
        """Return a camera's viewpoint; that of the wrist in the tool's frame."""
        if camera in self._viewpoints:
            return self._viewpoints[camera]
        pinhole = CAMERAS[camera]
        eye, target, up = (np.array(part) for part in (pinhole.eye, pinhole.target, pinhole.up))
        return looking_at(eye, target, math.radians(pinhole.fovy), up)

    def set_viewpoint(self, camera: str, viewpoint: Viewpoint) -> None:
        """Move a camera, until the next reset."""
        self._viewpoints[camera] = viewpoint
