"""Moves the cameras of ManiSkill's scenes, and keeps SAPIEN from computing a table for them."""

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


def sensor_of(env: Any, camera: str) -> str:
    """Return ManiSkill's name of a camera; of two arms, the wrist camera is that of the first."""
    name = SENSORS[camera]
    return name if name in env.scene.sensors else f"{env.agent.agents[0].uid}-0-{name}"


class ManiSkillCameras:
    """`Cameras` of `scene_control`. Moves SAPIEN's own cameras, since ManiSkill's configuration is fixed."""

    def __init__(self, env: Any, base_from_world: Any) -> None:
        """Take ManiSkill's environment, and SAPIEN's pose of the world in the base frame."""
        self._env, self._base_from_world = env, base_from_world
        self._moved: dict[str, tuple[Any, float]] = {}
        """Original pose and field of view of each camera that was moved."""

    def undo(self) -> None:
        """Restore every viewpoint."""
        for name, (pose, fovy) in self._moved.items():
            self._place(name, pose, fovy)
        self._moved.clear()

    def viewpoint(self, camera: str) -> Viewpoint:
        """Return a camera's present viewpoint; that of the wrist in the frame of its mount."""
        seen = self._component(sensor_of(self._env, camera))
        pose = seen.get_local_pose()
        if camera == "third_person":
            pose = self._base_from_world * pose
        rotation = Rotation.from_quat(wxyz_to_xyzw(pose.q)).as_matrix() @ RIGHT_DOWN_FORWARD
        return Viewpoint(pose.p.astype(np.float64), rotation, float(seen.fovy))

    def set_viewpoint(self, camera: str, viewpoint: Viewpoint) -> None:
        """Move a camera, until the next reset."""
        import sapien

        quaternion = Rotation.from_matrix(viewpoint.rotation @ RIGHT_DOWN_FORWARD.T).as_quat()
        pose = sapien.Pose(viewpoint.position, np.roll(quaternion, 1))
        names = [sensor_of(self._env, camera)]
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
        """Return SAPIEN's camera behind that of ManiSkill."""
        scene = self._env.scene
        return (scene.human_render_cameras if name == PICTURE else scene.sensors)[name].camera._render_cameras[0]


def omit_reflections(env: Any) -> None:
    """Replace the table of reflections that SAPIEN computes for the first image, in 6 s without a GPU.

    Shaders multiply it by the light of the environment map. These scenes have none, so the table changes no pixel.
    Cameras lose it when they move to another scene.
    """
    import sapien

    table = sapien.render.RenderTexture(np.zeros((1, 1, 4), np.uint8), 2, "R8G8B8A8Unorm")
    for camera in env.scene.sub_scenes[0].render_system.cameras:
        camera.set_texture("BRDFLUT", table)
