"""Moves the cameras of ManiSkill's scenes."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.scene_control import Viewpoint

PICTURE = "render_camera"
SENSORS = {"third_person": "base_camera", "wrist": "hand_camera"}
RIGHT_DOWN_FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""The image's right, down and forward, as columns, in SAPIEN's camera frame: x forward, y left, z up."""


class ManiSkillCameras:
    """See `scene_control.Cameras`. SAPIEN's own cameras are moved: ManiSkill takes its configuration as fixed."""

    def __init__(self, env: Any, base_from_world: Any) -> None:
        """Args: env: ManiSkill's environment; base_from_world: SAPIEN pose."""
        self._env, self._base_from_world = env, base_from_world
        self._moved: dict[str, tuple[Any, float]] = {}
        """Own pose and field of view of each camera that was moved, to the bit."""

    def undo(self) -> None:
        """Give every camera its own viewpoint back."""
        for name, (pose, fovy) in self._moved.items():
            self._place(name, pose, fovy)
        self._moved.clear()

    def viewpoint(self, camera: str) -> Viewpoint:
        """A camera's viewpoint, as SAPIEN has it; that of the wrist in the frame of its mount."""
        seen = self._component(SENSORS[camera])
        pose = seen.get_local_pose()
        if camera == "third_person":
            pose = self._base_from_world * pose
        rotation = Rotation.from_quat(wxyz_to_xyzw(pose.q)).as_matrix() @ RIGHT_DOWN_FORWARD
        return Viewpoint(pose.p.astype(np.float64), rotation, float(seen.fovy))

    def set_viewpoint(self, camera: str, viewpoint: Viewpoint) -> None:
        """Give a camera another viewpoint, until the next reset."""
        import sapien

        quaternion = Rotation.from_matrix(viewpoint.rotation @ RIGHT_DOWN_FORWARD.T).as_quat()
        pose = sapien.Pose(viewpoint.position, np.roll(quaternion, 1))
        names = [SENSORS[camera]]
        if camera == "third_person":
            pose = self._base_from_world.inv() * pose
            names.append(PICTURE)
        for name in names:
            seen = self._component(name)
            self._moved.setdefault(name, (seen.get_local_pose(), seen.fovy))
            self._place(name, pose, viewpoint.fovy)

    def _place(self, name: str, pose: Any, fovy: float) -> None:
        seen = self._component(name)
        seen.set_local_pose(pose)
        seen.set_fovy(fovy, compute_x=True)

    def _component(self, name: str) -> Any:
        """SAPIEN's own camera behind ManiSkill's."""
        scene = self._env.scene
        return (scene.human_render_cameras if name == PICTURE else scene.sensors)[name].camera._render_cameras[0]
