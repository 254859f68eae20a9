"""Where toysim is looked at from, and the one thing of its world that perturbations may adjust so far."""

from __future__ import annotations

import numpy as np

from adapters.adjusting import Viewpoint
from adapters.viewpoints import looking_at

OWN_VIEWPOINTS = {
    "third_person": looking_at(np.array([1.28, 0.36, 0.52]), np.array([0.5, 0.0, 0.0]), fovy=0.7),
    # In the frame of the tool, whose z axis points out of the gripper: beside the hand, looking past the fingertips.
    "wrist": looking_at(np.array([0.1, 0.0, -0.12]), np.array([0.0, 0.0, 0.04]), 1.3, up=np.array([-1.0, 0.0, 0.0])),
}


class ToysimCameras:
    """See `adapters.adjusting.Cameras`: with it, perturbations can move the cameras."""

    def __init__(self) -> None:
        self.now = dict(OWN_VIEWPOINTS)

    def viewpoint(self, camera: str) -> Viewpoint:
        """Where a camera is now."""
        return self.now[camera]

    def set_viewpoint(self, camera: str, viewpoint: Viewpoint) -> None:
        """Put it elsewhere, until the next reset."""
        self.now[camera] = viewpoint
