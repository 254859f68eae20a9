"""The arm of the DROID data set (Khazatsky et al. 2024): its start, the mount of its gripper, and its cameras.

The cameras have the poses of public simulations of this platform (sim-evals, RoboLab): the exterior one is left of the
base and looks over the table, the other is in front of the gripper. Their square images are the middle of the wide ones
that the ZEDs take, at their full height.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from robogauntlet.adapters.camera_geometry import looking_at
from robogauntlet.adapters.mujoco_parts.cameras import MujocoCameras

START = np.pi * np.array([0.0, -0.2, 0.0, -0.8, 0.0, 0.6, 0.0])
"""Angles of the joints at the start (rad), which noise is added to."""
EXTERIOR, LOOKING_AT = np.array([0.05, 0.57, 0.66]), np.array([0.66, 0.08, 0.0])
"""Position of the exterior camera, and a point that it looks at (m, frame of the base)."""
AT_GRIPPER, ALONG = np.array([0.074, -0.031, 0.011]), np.array([-0.31, -0.01, 0.95])
"""Position of the wrist camera (m), and its direction, in the frame of the hand."""
SENSOR, LENSES = 3.024, (2.1, 2.8)
"""Height of the ZEDs' sensors, and focal lengths of the exterior and the wrist camera (mm)."""


def set_up(robot: Any, model: Any, cameras: MujocoCameras) -> None:
    """Give robosuite's Panda the start, mount and cameras of DROID's.

    DROID's gripper is mounted without the 45 degrees of the Franka hand, so that its fingers open to left and right at
    an angle of 0 of the last joint.
    """
    robot.init_qpos = START
    model.body(robot.robot_model.eef_name["right"]).quat[:] = (1.0, 0.0, 0.0, 0.0)
    exterior, wrist = (float(2.0 * np.arctan(SENSOR / 2.0 / length)) for length in LENSES)
    cameras.set_viewpoint("third_person", looking_at(EXTERIOR, LOOKING_AT, exterior))
    forward = np.array([1.0, 0.0, 0.0])
    cameras.set_viewpoint("wrist", looking_at(AT_GRIPPER, AT_GRIPPER + ALONG, wrist, up=forward))
    cameras.keep()
