"""The common part of simulations of arms in MuJoCo: rendering and reading the state."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from robogauntlet.adapters.base_simulation import BaseSimulation
from robogauntlet.adapters.contract import (
    ARM_PREFIXES,
    ActionSpec,
    FloatArray,
    Image,
    Motion,
    Observation,
    SimulatorUnavailable,
)
from robogauntlet.adapters.frames import hash_state, wxyz_to_xyzw
from robogauntlet.adapters.mujoco_parts.cameras import CAMERA_NAMES
from robogauntlet.adapters.mujoco_parts.contacts import MujocoContacts
from robogauntlet.adapters.mujoco_parts.fingers import Fingers, NoFingers, Pads, SlidingFingers
from robogauntlet.adapters.mujoco_parts.lights import MujocoLights
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.mujoco_parts.table import MujocoTable
from robogauntlet.adapters.mujoco_scene import MujocoScene, drawing_device, engine_time, import_mujoco, no_rendering
from robogauntlet.adapters.scene_control import SceneControls
from robogauntlet.suites.episode import View


class ArmJoints(Protocol):
    """The joints of arms, for those whose actions are of joints."""

    qvel_index: Any
    """Their degrees of freedom, those of two arms in order."""

    def angles(self, arm: int) -> FloatArray:
        """Return the angles of an arm's joints (n,), rad."""

    def targets(self, arm: int) -> FloatArray:
        """Return their present targets (n,), rad."""

    def gripper(self, arm: int) -> FloatArray:
        """Return how far its gripper is closed (1,), from -1 (open) to 1."""

    def state(self) -> dict[str, FloatArray]:
        """Return what the next steps depend on besides MuJoCo's positions and velocities, for the state's hash."""


@dataclass(frozen=True)
class _Arm:
    """An arm and its gripper."""

    prefix: str
    """One of `ARM_PREFIXES`."""
    base: str
    """Name of the body that carries it."""
    joints: Sequence[str]
    """Of the gripper."""
    physics: MujocoPhysics
    tool_centre: Any
    hand: Any
    fingers: Fingers

    def state(self) -> dict[str, FloatArray]:
        """Return the entries that every `privileged_state` has of an arm, in the frame of its base."""
        position, quaternion = self.physics.pose_from_world(self.tool_centre.xpos, self.hand.xmat)
        return {
            f"{self.prefix}tcp_position": position,
            f"{self.prefix}tcp_quaternion": quaternion,
            f"{self.prefix}finger_positions": self.fingers.positions(),
        }


class MujocoSimulation(BaseSimulation):
    """A `Simulation` that renders, reads and closes. Subclasses reset and step."""

    culling = True
    scene_controls: SceneControls
    _lights: MujocoLights
    _table: MujocoTable | None

    _joints: ArmJoints | None = None
    """The joints, if actions are of them."""
    _env: Any = None
    """robosuite's environment, if the task is one of its."""

    def __init__(
        self, mujoco: Any, model: Any, data: Any, view: View, instruction: str, action_spec: ActionSpec
    ) -> None:
        """Take MuJoCo's module, model and data, see `BaseSimulation` for the others."""
        super().__init__(view, instruction, action_spec)
        self._mujoco, self._model, self._data = mujoco, model, data
        self._arms: list[_Arm] = []
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)  # They are not read.
        option = mujoco.MjvOption()
        option.geomgroup[0] = 0  # Collision shapes.
        self._scene = MujocoScene(self._model, self._data, view.render_profile, option)

    def _take_arm(
        self,
        base: str,
        tool_centre: str,
        hand: str,
        fingers: list[str],
        pads: tuple[Sequence[str], Sequence[str]] | None = None,
    ) -> None:
        """Take the names of a robot's base body, the tool's site and body, and the gripper's joints, if it has any.

        `pads` has the shapes at the fingertips of each side, where the joints are no slides. Of two arms, the first is
        taken first; all but the second's own numbers are in the frame of its base.
        """
        physics = MujocoPhysics(self._mujoco, self._model, self._data, base)
        side: Fingers = NoFingers()
        if fingers:
            side = Pads(physics, hand, pads) if pads else SlidingFingers(physics, fingers)
        # The hand, not the site in it: along its y axis the fingers open, as in the other simulators.
        prefix, tool, body = ARM_PREFIXES[len(self._arms)], self._data.site(tool_centre), self._data.body(hand)
        self._arms.append(_Arm(prefix, base, fingers, physics, tool, body, side))
        self._physics = self._arms[0].physics

    def _take_objects(self, bodies: Iterable[str], places: Mapping[str, Any], angles: Mapping[str, Any]) -> None:
        """Take the bodies of the task's objects, and by name what `motion` reads: places with `xpos`, and joints."""
        bases, joints = [arm.base for arm in self._arms], [joint for arm in self._arms for joint in arm.joints]
        self._contacts = MujocoContacts(self._physics, bases, joints, bodies)
        self._places, self._angles = {"tcp": self._arms[0].tool_centre, **places}, angles

    def state_hash(self) -> str:
        """Hash joint positions and velocities, the poses of fixed bodies, and the targets of joints."""
        state = {"qpos": self._data.qpos, "qvel": self._data.qvel}
        state |= {"body_pos": self._model.body_pos, "body_quat": self._model.body_quat}
        return hash_state(state | (self._joints.state() if self._joints else {}))

    def render_device(self) -> str:
        """Return OpenGL's name of the renderer."""
        self.draw("third_person", self.view.image_size)
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

    def observe(self) -> Observation:
        """Render the cameras of the view and read the arm, and its hand's quaternion as MuJoCo has it."""
        return replace(super().observe(), hand_quaternion=wxyz_to_xyzw(self._arms[0].hand.xquat))

    def draw(self, camera: str, size: int) -> Image:
        """Render the present state, (size, size, 3)."""
        self._refresh()
        props = self._table.draw if self._table else None
        image = self._scene.image(CAMERA_NAMES[camera], size, props, culling=self.culling)
        return self._lights.develop(image)

    def _refresh(self) -> None:
        """Bring poses up to date: a physics step ends with new joint positions, and the poses of the ones before."""
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_comPos(self._model, self._data)  # Cameras and lights may follow centres of mass.
        self._mujoco.mj_camlight(self._model, self._data)

    def arm_state(self) -> dict[str, FloatArray]:
        """Bring poses up to date, and return the entries that every `privileged_state` has."""
        self._refresh()
        state = {name: value for arm in self._arms for name, value in arm.state().items()}
        if self._joints is not None:
            for number, arm in enumerate(self._arms):
                state |= self._of_joints(self._joints, number, arm)
        return state

    def _of_joints(self, joints: ArmJoints, number: int, arm: _Arm) -> dict[str, FloatArray]:
        """Return what `privileged_state` has of an arm whose actions are of joints."""
        parts = np.zeros((2, 3, self._model.nv))
        self._mujoco.mj_jacSite(self._model, self._data, *parts, arm.tool_centre.id)
        turn, dofs = arm.physics.rotation.inv().as_matrix(), np.split(joints.qvel_index, len(self._arms))[number]
        return {
            f"{arm.prefix}joint_angles": joints.angles(number),
            f"{arm.prefix}joint_targets": joints.targets(number),
            f"{arm.prefix}gripper": joints.gripper(number),
            f"{arm.prefix}tcp_jacobian": np.concatenate([turn @ part[:, dofs] for part in parts]),
        }

    def motion(self, entries: Sequence[str]) -> Motion:
        """Return the tool, these positions and joint values, contacts and joint limits."""
        self._mujoco.mj_kinematics(self._model, self._data)
        base = self._physics.base
        origin, axes = base.xpos, base.xmat.reshape(3, 3)

        def value(entry: str) -> FloatArray:
            if entry in self._angles:
                return np.array(self._angles[entry].qpos)
            return np.asarray((self._places[entry.removesuffix("_position")].xpos - origin) @ axes)

        return Motion(
            tool=value("tcp_position"),
            opening=self._arms[0].fingers.opening(),
            entries=tuple(map(value, entries)),
            contact_force=self._contacts.contact_force(),
            joint_margin=self._contacts.joint_margin(),
        )

    def _poses(self, parts: Mapping[str, Any]) -> dict[str, FloatArray]:
        """Return `<name>_position` and `<name>_quaternion` of bodies or sites of the data, in the base frame."""
        state: dict[str, FloatArray] = {}
        for name, pose in parts.items():
            position, quaternion = self._physics.pose_from_world(pose.xpos, pose.xmat)
            state |= {f"{name}_position": position, f"{name}_quaternion": quaternion}
        return state

    def engine_time(self) -> float:
        """Return the CPU time of MuJoCo alone in a control step from the present state (s), which stays as it is."""
        return engine_time(self._model, self._data, self._physics_steps)

    @property
    def _physics_steps(self) -> int:
        """Number of physics steps in a control step."""
        return round(1.0 / self.action_spec.control_hz / float(self._model.opt.timestep))


def model_of(env: Any) -> tuple[Any, Any]:
    """Return MuJoCo's model and data of a robosuite environment, and stop the updates of its observables.

    There are 25 in a control step, and they are not used.
    """
    for name in env.observation_names:
        env.modify_observable(name, "enabled", False)
    return env.sim.model._model, env.sim.data._data


def import_with_mujoco(extra: str, *modules: str) -> tuple[Any, ...]:
    """Import mujoco with a renderer, then modules that an extra of robogauntlet installs, without robosuite's warnings.

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
