"""What simulations of robosuite's arms have in common, whatever its version: looking at the world and reading it."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.adjusting import Adjusters
from adapters.contract import PICTURE_SIZE, FloatArray, Image, Observation, ObservationSpec, SimulatorUnavailable
from adapters.frames import axis_angle, hash_state, relative_pose
from adapters.mujoco_parts.cameras import CAMERA_NAMES
from adapters.mujoco_parts.lights import MujocoLights
from adapters.mujoco_parts.stage import MujocoStage
from adapters.mujoco_scene import MujocoScene, drawing_device, import_mujoco, no_rendering
from suites.vocabulary import View


class MujocoSimulation:
    """The half of `adapters.contract.Simulation` that looks and reads. Who inherits it resets, steps and closes."""

    adjusters: Adjusters
    _lights: MujocoLights
    _stage: MujocoStage | None

    def __init__(self, mujoco: Any, simulator: tuple[Any, Any], view: View, instruction: str) -> None:
        """Take a world.

        Args:
            mujoco: The module.
            simulator: MuJoCo's model and data.
            view: What policies are shown.
            instruction: The goal in words.
        """
        self._mujoco, (self._model, self._data) = mujoco, simulator
        self._view, self._instruction = view, instruction
        self.observation_spec = ObservationSpec(view.cameras, view.image_size)
        option = mujoco.MjvOption()
        option.geomgroup[0] = 0  # Collision shapes.
        self._model.vis.global_.offwidth = self._model.vis.global_.offheight = 1  # As much as is needed, no window.
        self._scene = MujocoScene(self._model, self._data, view.render_profile, option)

    def _take_arm(self, base: str, tool_centre: str, hand: str, fingers: list[str]) -> None:
        """Say which body the robot stands on, which site and body the tool is, and which joints the fingers are."""
        self._base = self._data.body(base)
        self._tool_centre = self._data.site(tool_centre)
        # The hand, not the site in it: along its y axis the fingers open, as in the other simulators.
        self._hand = self._data.body(hand)
        self._fingers = [self._data.joint(name) for name in fingers]

    def observe(self) -> Observation:
        """Render the cameras of the view and read the proprioception."""
        images = {camera: self._draw(CAMERA_NAMES[camera], self._view.image_size) for camera in self._view.cameras}
        position, quaternion = self._tool_pose()
        proprioception = np.concatenate([position, axis_angle(quaternion), self._finger_positions()])
        return Observation(images, proprioception, self._instruction)

    def picture(self) -> Image:
        """The third-person view, (256, 256, 3)."""
        return self._draw(CAMERA_NAMES["third_person"], PICTURE_SIZE)

    def state_hash(self) -> str:
        """Hash of all joint positions and velocities, and of where the fixed bodies were put."""
        return hash_state(
            {
                "qpos": self._data.qpos,
                "qvel": self._data.qvel,
                "body_pos": self._model.body_pos,
                "body_quat": self._model.body_quat,
            }
        )

    def render_device(self) -> str:
        """OpenGL's name of what draws."""
        self._draw(CAMERA_NAMES["third_person"], self._view.image_size)
        return drawing_device()

    def _undo_adjustments(self) -> None:
        """Give the world back what was adjusted, but for what resets set anyway."""
        adjusters = self.adjusters
        for adjuster in (adjusters.cameras, adjusters.lights, adjusters.bodies, adjusters.stage):
            if adjuster is not None:
                adjuster.undo()  # type: ignore[union-attr]

    def _draw(self, camera: str, size: int) -> Image:
        """The world as it is now, (size, size, 3)."""
        self._refresh()
        return self._lights.develop(self._scene.image(camera, size, self._stage.draw if self._stage else None))

    def _settle(self) -> None:
        """Bring contacts and forces up to date for a world that was just put together.

        On its way, reset solves the contacts of the last episode's fixtures or of the objects' default poses, and the
        solver starts from its last solution.
        """
        self._data.qacc_warmstart[:] = 0.0
        self._mujoco.mj_forward(self._model, self._data)

    def _refresh(self) -> None:
        """Bring poses up to date: a physics step ends with new joint positions, and the poses of the ones before."""
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_comPos(self._model, self._data)  # Cameras and lights may follow centres of mass.
        self._mujoco.mj_camlight(self._model, self._data)

    def _arm_state(self) -> dict[str, FloatArray]:
        """What `privileged_state` always holds, with poses brought up to date."""
        self._refresh()
        position, quaternion = self._tool_pose()
        return {"tcp_position": position, "tcp_quaternion": quaternion, "finger_positions": self._finger_positions()}

    def _poses(self, things: Mapping[str, Any]) -> dict[str, FloatArray]:
        """`<name>_position` and `<name>_quaternion` of bodies or sites of the data, in the base frame."""
        state = {}
        for name, pose in things.items():
            state[f"{name}_position"], state[f"{name}_quaternion"] = self._in_base(pose.xpos, pose.xmat)
        return state

    def _tool_pose(self) -> tuple[FloatArray, FloatArray]:
        """Position (3,) and quaternion xyzw (4,) of the tool centre point in the base frame."""
        return self._in_base(self._tool_centre.xpos, self._hand.xmat)

    def _finger_positions(self) -> FloatArray:
        """How far each finger is from the middle (m), shape (2,)."""
        return np.abs([finger.qpos[0] for finger in self._fingers])

    def _in_base(self, position: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A world pose as position and quaternion xyzw in the base frame."""
        quaternion = Rotation.from_matrix(matrix.reshape(3, 3)).as_quat()
        base = Rotation.from_matrix(self._base.xmat.reshape(3, 3)).as_quat()
        return relative_pose(self._base.xpos, base, position, quaternion)


def reached_share(kp: float, control_hz: float) -> float:
    """Share of an offset that OSC_POSE covers in a control step of steady motion.

    It is a critically damped spring of stiffness `kp` (1/s^2) to a goal that is set anew, from the pose achieved, in
    each step: sqrt(kp) / 2 of the offset in a second.
    """
    return float(np.sqrt(kp)) / 2.0 / control_hz


def import_with_mujoco(extra: str, *modules: str) -> tuple[Any, ...]:
    """These modules after mujoco, with a renderer chosen and robosuite's start-up warnings silenced.

    Args:
        extra: The extra of this distribution that has them.
        modules: Import names.

    Raises:
        SimulatorUnavailable: One is missing, or MuJoCo finds no way to render.
    """
    mujoco = import_mujoco()
    logging.getLogger("robosuite_logs").addFilter(is_error)
    try:
        return mujoco, *(importlib.import_module(module) for module in modules)
    except ModuleNotFoundError as error:
        raise SimulatorUnavailable(f"{error}: pip install robogauntlet[{extra}]") from error
    except Exception as error:  # They open a display too; the GL bindings raise what they like.
        raise no_rendering(error) from error


def is_error(record: logging.LogRecord) -> bool:
    """Filter of robosuite's log: its warnings about private macros and optional robots concern nobody here."""
    return record.levelno >= logging.ERROR
