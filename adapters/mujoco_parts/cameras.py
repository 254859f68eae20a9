"""Moves the cameras of models based on robosuite."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.scene_control import Viewpoint

CAMERA_NAMES = {"third_person": "agentview", "wrist": "robot0_eye_in_hand"}
RIGHT_DOWN_FORWARD = np.diag([1.0, -1.0, -1.0])
"""The image's right, down and forward, as columns, in MuJoCo's camera frame: x right, y up, looking along -z."""


class MujocoCameras:
    """`Cameras` of `scene_control`. Changes the model; poses follow when the scene is next rendered."""

    def __init__(self, physics: MujocoPhysics) -> None:
        self._physics, self._model = physics, physics.model
        self._moved: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {}
        """Original position, quaternion and field of view of each camera that was moved."""

    def keep(self) -> None:
        """Take the present viewpoints as those that `undo` restores."""
        self._moved.clear()

    def undo(self) -> None:
        """Restore every viewpoint."""
        for camera, own in self._moved.items():
            self._place(camera, *own)
        self._moved.clear()

    def viewpoint(self, camera: str) -> Viewpoint:
        """Return a camera's present viewpoint; that of the wrist in the frame of the hand."""
        seen = self._model.camera(CAMERA_NAMES[camera])
        position, quaternion = seen.pos, wxyz_to_xyzw(seen.quat)
        if camera == "third_person":
            position, quaternion = self._physics.pose_from_world(position, quaternion)
        rotation = Rotation.from_quat(quaternion).as_matrix() @ RIGHT_DOWN_FORWARD
        return Viewpoint(np.array(position), rotation, math.radians(float(seen.fovy[0])))

    def set_viewpoint(self, camera: str, viewpoint: Viewpoint) -> None:
        """Move a camera, until the next reset."""
        position, turned = viewpoint.position, Rotation.from_matrix(viewpoint.rotation @ RIGHT_DOWN_FORWARD.T)
        if camera == "third_person":
            position, turned = self._physics.to_world(position), self._physics.rotation * turned
        seen = self._model.camera(CAMERA_NAMES[camera])
        self._moved.setdefault(camera, (seen.pos.copy(), seen.quat.copy(), seen.fovy.copy()))
        self._place(camera, position, np.roll(turned.as_quat(), 1), np.array([math.degrees(viewpoint.fovy)]))

    def _place(self, camera: str, position: FloatArray, quaternion: FloatArray, fovy: FloatArray) -> None:
        seen = self._model.camera(CAMERA_NAMES[camera])
        seen.pos[:], seen.quat[:], seen.fovy[:] = position, quaternion, fovy
