"""The cameras of toysim, the one scene control that it has so far."""

from __future__ import annotations

import numpy as np

from robogauntlet.adapters.camera_geometry import looking_at
from robogauntlet.adapters.scene_control import Viewpoint

OWN_VIEWPOINTS = {
    "third_person": looking_at(np.array([1.28, 0.36, 0.52]), np.array([0.5, 0.0, 0.0]), fovy=0.7),
    # In the frame of the tool, whose z axis points out of the gripper: beside the hand, looking past the fingertips.
    "wrist": looking_at(np.array([0.1, 0.0, -0.12]), np.array([0.0, 0.0, 0.04]), 1.3, up=np.array([-1.0, 0.0, 0.0])),
}


class ToysimCameras:
    """Lets perturbations move the cameras, see `robogauntlet.adapters.scene_control.Cameras`."""

    def __init__(self) -> None:
        self.now = dict(OWN_VIEWPOINTS)

    def viewpoint(self, camera: str) -> Viewpoint:
        """Return the present viewpoint of a camera."""
        return self.now[camera]

    def set_viewpoint(self, camera: str, viewpoint: Viewpoint) -> None:
        """Move a camera, until the next reset."""
        self.now[camera] = viewpoint
