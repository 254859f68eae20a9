"""Tasks of ManiSkill with other robots than a Panda with a wrist camera, as ManiSkill has them.

An action is that of ManiSkill's default controller (`pd_joint_delta_pos`): numbers from -1 to 1 that move joints, and a
gripper's. Proprioception is positions and velocities of all joints. The camera is ManiSkill's own `base_camera`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robogauntlet.adapters.base_simulation import BaseSimulation
from robogauntlet.adapters.contract import PICTURE_SIZE, FloatArray, Image, StepOutcome
from robogauntlet.adapters.frames import hash_state
from robogauntlet.adapters.maniskill.assets import check_assets
from robogauntlet.adapters.maniskill.dynamics import renew_physics
from robogauntlet.adapters.maniskill.environment import make_environment, render_device
from robogauntlet.adapters.maniskill.native_tasks import ROBOTS, TASKS
from robogauntlet.suites.episode import View

SENSOR, PICTURE = "base_camera", "render_camera"


class NativeSimulation(BaseSimulation):
    """One such task, see `robogauntlet.adapters.contract.Simulation`."""

    def __init__(self, task: str, view: View) -> None:
        """Make the environment. Raises SimulatorUnavailable, TaskUnavailable."""
        check_assets(task)
        super().__init__(view, TASKS[task].instruction, ROBOTS[TASKS[task].robot].spec)
        self._env = make_environment(task, self._cameras, reward_mode="sparse")

    def _cameras(self, look_at: Any) -> dict[str, Any]:
        size = {"width": self.view.image_size, "height": self.view.image_size}
        shown = {"width": PICTURE_SIZE, "height": PICTURE_SIZE, "shader_pack": "minimal"}
        return {"sensor_configs": {SENSOR: size}, "human_render_camera_configs": {PICTURE: shown}}

    def reset(self, seed: int) -> None:
        """Start the episode of `seed`, in a new PhysX scene, which some tasks make themselves."""
        if not self._env.reconfiguration_freq:
            renew_physics(self._env)
        self._env.reset(seed=seed)
        scene = self._env.scene
        seen, shown = (
            sensor.camera._render_cameras[0] for sensor in (scene.sensors[SENSOR], scene.human_render_cameras[PICTURE])
        )
        shown.set_local_pose(seen.get_local_pose())
        shown.set_fovy(seen.fovy, True)

    def step(self, action: FloatArray) -> StepOutcome:
        """Apply `action` for one control step. It ends where the task says that it has failed."""
        import torch

        command = np.clip(action, self.action_spec.low, self.action_spec.high).astype(np.float32)
        *_, info = self._env.step(torch.from_numpy(command)[None])
        success = bool(info["success"])
        return StepOutcome(float(success), success, bool(info.get("fail", False)))

    def privileged_state(self) -> Mapping[str, FloatArray]:
        """Return positions and velocities of the joints (rad, m), and an action that moves no target."""
        robot = self._env.agent.robot
        parts = [part.numpy()[0].astype(np.float64) for part in (robot.get_qpos(), robot.get_qvel())]
        return {"state": np.concatenate(parts), "still": np.zeros(len(self.action_spec.numbers))}

    def state_hash(self) -> str:
        """Hash joint positions and velocities, and the poses and velocities of all actors."""
        state = self._env.get_state_dict()
        kinds = ("actors", "articulations")
        return hash_state(
            {f"{kind}/{name}": value.numpy() for kind in kinds for name, value in state.get(kind, {}).items()}
        )

    def draw(self, camera: str, size: int) -> Image:
        """Render ManiSkill's own camera."""
        return self._captured(self._env.scene.sensors[SENSOR])

    def picture(self) -> Image:
        """Render the same view, (256, 256, 3)."""
        return self._captured(self._env.scene.human_render_cameras[PICTURE])

    def _captured(self, sensor: Any) -> Image:
        self._env.scene.update_render()
        camera = sensor.camera._render_cameras[0]
        camera.take_picture()
        return np.array(camera.get_picture("Color")[..., :3])

    def render_device(self) -> str:
        """Return the name of the Vulkan device."""
        return render_device()

    def close(self) -> None:
        """Free the scene. Safe to call twice."""
        if self._env is not None:
            self._env.close()
        self._env = None
