"""The common part of simulations with robosuite's arms: rendering and reading the state."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import (
    PICTURE_SIZE,
    FloatArray,
    Image,
    Observation,
    ObservationSpec,
    SimulatorUnavailable,
)
from robogauntlet.adapters.frames import hash_state, proprioception, relative_pose
from robogauntlet.adapters.mujoco_parts.cameras import CAMERA_NAMES
from robogauntlet.adapters.mujoco_parts.lights import MujocoLights
from robogauntlet.adapters.mujoco_parts.stage import MujocoStage
from robogauntlet.adapters.mujoco_scene import MujocoScene, drawing_device, import_mujoco, no_rendering
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.suites.episode import View


class MujocoSimulation:
    """The part of a `Simulation` that renders, reads and closes. Subclasses reset and step."""

    scene_controls: SceneControls
    _env: Any
    _lights: MujocoLights
    _stage: MujocoStage | None

    def __init__(self, mujoco: Any, simulator: tuple[Any, Any], view: View, instruction: str) -> None:
        """Take a MuJoCo model.

        Args:
            mujoco: The module.
            simulator: MuJoCo's model and data.
            view: Cameras and image size for policies.
            instruction: The goal in words.
        """
        self._mujoco, (self._model, self._data) = mujoco, simulator
        self._view, self._instruction = view, instruction
        self.observation_spec = ObservationSpec(view.cameras, view.image_size)
        option = mujoco.MjvOption()
        option.geomgroup[0] = 0  # Collision shapes.
        self._model.vis.global_.offwidth = self._model.vis.global_.offheight = (
            1  # As large as needed; there is no window.
        )
        self._scene = MujocoScene(self._model, self._data, view.render_profile, option)

    def _take_arm(self, base: str, tool_centre: str, hand: str, fingers: list[str]) -> None:
        """Take the names of the robot's base body, the tool's site and body, and the fingers' joints."""
        self._base = self._data.body(base)
        self._tool_centre = self._data.site(tool_centre)
        # The hand, not the site in it: along its y axis the fingers open, as in the other simulators.
        self._hand = self._data.body(hand)
        self._fingers = [self._data.joint(name) for name in fingers]

    def observe(self) -> Observation:
        """Render the cameras of the view and read the proprioception."""
        images = {camera: self._draw(CAMERA_NAMES[camera], self._view.image_size) for camera in self._view.cameras}
        return Observation(images, proprioception(self._arm_state()), self._instruction)

    def picture(self) -> Image:
        """Render the third-person view, (256, 256, 3)."""
        return self._draw(CAMERA_NAMES["third_person"], PICTURE_SIZE)

    def state_hash(self) -> str:
        """Hash joint positions and velocities, and the poses of fixed bodies."""
        return hash_state(
            {
                "qpos": self._data.qpos,
                "qvel": self._data.qvel,
                "body_pos": self._model.body_pos,
                "body_quat": self._model.body_quat,
            }
        )

    def render_device(self) -> str:
        """Return OpenGL's name of the renderer."""
        self._draw(CAMERA_NAMES["third_person"], self._view.image_size)
        return drawing_device()

    def close(self) -> None:
        """Free the renderers and the model. Safe to call twice."""
        self._scene.close()
        if self._env is not None:
            self._env.close()
        self._env = None

    def _check_rendering(self) -> None:
        """Close everything if this machine cannot render.

        Raises:
            SimulatorUnavailable: This machine cannot render.
        """
        try:
            self.render_device()
        except SimulatorUnavailable:
            self.close()
            raise

    def _draw(self, camera: str, size: int) -> Image:
        """Render the present state, (size, size, 3)."""
        self._refresh()
        return self._lights.develop(self._scene.image(camera, size, self._stage.draw if self._stage else None))

    def _settle(self) -> None:
        """Bring contacts and forces up to date after a reset, with a cold start of the solver.

        The reset itself solves contacts of the last episode's fixtures or of default poses, from which the solver would
        otherwise start.
        """
        self._data.qacc_warmstart[:] = 0.0
        self._mujoco.mj_forward(self._model, self._data)

    def _refresh(self) -> None:
        """Bring poses up to date: a physics step ends with new joint positions, and the poses of the ones before."""
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_comPos(self._model, self._data)  # Cameras and lights may follow centres of mass.
        self._mujoco.mj_camlight(self._model, self._data)

    def _arm_state(self) -> dict[str, FloatArray]:
        """Bring poses up to date, and return the entries that every `privileged_state` has."""
        self._refresh()
        position, quaternion = self._tool_pose()
        return {"tcp_position": position, "tcp_quaternion": quaternion, "finger_positions": self._finger_positions()}

    def _poses(self, things: Mapping[str, Any]) -> dict[str, FloatArray]:
        """Return `<name>_position` and `<name>_quaternion` of bodies or sites of the data, in the base frame."""
        state = {}
        for name, pose in things.items():
            state[f"{name}_position"], state[f"{name}_quaternion"] = self._in_base(pose.xpos, pose.xmat)
        return state

    def _tool_pose(self) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) and quaternion xyzw (4,) of the tool centre point in the base frame."""
        return self._in_base(self._tool_centre.xpos, self._hand.xmat)

    def _finger_positions(self) -> FloatArray:
        """Return the distance of each finger from the middle (m), shape (2,)."""
        return np.abs([finger.qpos[0] for finger in self._fingers])

    def _in_base(self, position: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Convert a world pose to position and quaternion xyzw in the base frame."""
        quaternion = Rotation.from_matrix(matrix.reshape(3, 3)).as_quat()
        base = Rotation.from_matrix(self._base.xmat.reshape(3, 3)).as_quat()
        return relative_pose(self._base.xpos, base, position, quaternion)


def reached_share(kp: float, control_hz: float) -> float:
    """Return the share of an offset that OSC_POSE covers in a control step of steady motion.

    It is a critically damped spring of stiffness `kp` (1/s^2) to a goal that is set again in each step, relative to the
    present pose: sqrt(kp) / 2 of the offset in a second.
    """
    return float(np.sqrt(kp)) / 2.0 / control_hz


def import_with_mujoco(extra: str, *modules: str) -> tuple[Any, ...]:
    """Import mujoco with a renderer, then other modules, without robosuite's warnings.

    Args:
        extra: Extra of robogauntlet that installs them.
        modules: Import names.

    Raises:
        SimulatorUnavailable: A module or MuJoCo's renderer is missing.
    """
    mujoco = import_mujoco()
    logging.getLogger("robosuite_logs").addFilter(is_error)
    try:
        return mujoco, *(importlib.import_module(module) for module in modules)
    except ModuleNotFoundError as error:
        raise SimulatorUnavailable(f'{error}; install it: pip install "robogauntlet[{extra}]"') from error
    except Exception as error:  # They open a display too; the GL bindings raise exceptions of any type.
        raise no_rendering(error) from error


def is_error(record: logging.LogRecord) -> bool:
    """Filter robosuite's log, whose warnings about private macros and optional robots do not matter here."""
    return record.levelno >= logging.ERROR
