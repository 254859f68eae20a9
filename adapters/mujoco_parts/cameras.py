"""Moves the cameras of models based on robosuite."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import relative_pose, wxyz_to_xyzw
from robogauntlet.adapters.scene_control import Viewpoint

CAMERA_NAMES = {"third_person": "agentview", "wrist": "robot0_eye_in_hand"}
RIGHT_DOWN_FORWARD = np.diag([1.0, -1.0, -1.0])
"""The image's right, down and forward, as columns, in MuJoCo's camera frame: x right, y up, looking along -z."""


class MujocoCameras:
    """`Cameras` of `scene_control`. Changes the model; poses follow when the scene is next rendered."""

    def __init__(self, model: Any, base: Any) -> None:
        """Take MuJoCo's model, and the body of the data that carries the robot."""
        self._model, self._base = model, base
        self._moved: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {}
        """Original position, quaternion and field of view of each camera that was moved."""

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
            position, quaternion = relative_pose(self._base.xpos, self._base_quaternion(), position, quaternion)
        rotation = Rotation.from_quat(quaternion).as_matrix() @ RIGHT_DOWN_FORWARD
        return Viewpoint(np.array(position), rotation, math.radians(float(seen.fovy[0])))

    def set_viewpoint(self, camera: str, viewpoint: Viewpoint) -> None:
        """Move a camera, until the next reset."""
        position, turned = viewpoint.position, Rotation.from_matrix(viewpoint.rotation @ RIGHT_DOWN_FORWARD.T)
        if camera == "third_person":
            base = Rotation.from_quat(self._base_quaternion())
            position, turned = base.apply(position) + self._base.xpos, base * turned
        seen = self._model.camera(CAMERA_NAMES[camera])
        self._moved.setdefault(camera, (seen.pos.copy(), seen.quat.copy(), seen.fovy.copy()))
        self._place(camera, position, np.roll(turned.as_quat(), 1), np.array([math.degrees(viewpoint.fovy)]))

    def _place(self, camera: str, position: FloatArray, quaternion: FloatArray, fovy: FloatArray) -> None:
        seen = self._model.camera(CAMERA_NAMES[camera])
        seen.pos[:], seen.quat[:], seen.fovy[:] = position, quaternion, fovy

    def _base_quaternion(self) -> FloatArray:
        return Rotation.from_matrix(self._base.xmat.reshape(3, 3)).as_quat()
