"""Runs robosuite's control steps without what no one reads, equal to the bit.

A control step of robosuite is 25 physics steps, each with new torques, for which robosuite looks up names, limits and
references in Python; that costs nine times as much as the physics. Here robosuite sets a step's goal, and compiled code
computes the torques towards it from MuJoCo's arrays.
"""

from __future__ import annotations

import importlib
import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.support.errors import describe

REMEDY = "With a processor that is newer than NumPy's OpenBLAS, OPENBLAS_CORETYPE=Haswell in the environment helps"
"""NumPy's OpenBLAS takes it for one without AVX, SciPy's, which numba uses, does not, and both round otherwise."""
TRIALS = 50
"""Random states in which robosuite's torques and those of the compiled code are compared."""


class Version(NamedTuple):
    """What differs between robosuite's versions."""

    controller: Callable[[], Any]
    """Returns the present controller of the arm. Resets create a new one."""
    tool: tuple[str, str, str]
    """Its attributes with the name of the tool's site, the tool's position and rotation."""
    actuators: tuple[Sequence[int], Sequence[int]]
    """Of the arm, of the gripper."""
    set_goal: Callable[[Any, FloatArray, int], tuple[FloatArray, FloatArray, FloatArray]]
    """Sets the controller's goal by an action, for a number of physics steps. Returns the tool's position and rotation
    in the world, and the gripper's commands in [-1, 1], (physics steps, actuators)."""


class ControlLoop:
    """Runs control steps of a robosuite environment with one arm on a fixed base.

    Resets, `update_initial_joints` and robosuite's own `step` may come in between. The compiled law is tried out: where
    it is not that of the configured controller, another build of BLAS rounds otherwise, or it cannot be compiled,
    robosuite's own `step` is used.
    """

    def __init__(self, physics: MujocoPhysics, env: Any, version: Version) -> None:
        """Take the environment, which must be reset afterwards."""
        self._mujoco, self._model, self._data = physics.mujoco, physics.model, physics.data
        self._env, self._version = env, version
        self._steps = int(env.control_timestep / env.model_timestep)
        low, high = self._model.actuator_ctrlrange[version.actuators[1]].T
        self._grip_middle, self._grip_half = 0.5 * (high + low), 0.5 * (high - low)
        try:
            self._law = importlib.import_module("robogauntlet.adapters.mujoco_parts.operational_space")
            self._arm = self._bind(version.controller(), *map(consecutive, version.actuators))
            problem = "" if self._agrees() else "gives other torques than robosuite's controller on this machine"
        except Exception as error:  # numba raises many kinds, by its version and settings
            problem = f"cannot be compiled ({describe(error)})"
        self.exact = not problem
        """Whether steps are those of the compiled code."""
        if problem:
            logging.getLogger(__name__).warning(
                "the compiled control law %s; robosuite's own step is used, which takes several times as long. %s",
                problem,
                REMEDY,
            )

    def step(self, action: FloatArray) -> None:
        """Run the physics steps of one control step. `action` is robosuite's."""
        if not self.exact:
            self._env.step(action)
            return
        self._mujoco.mj_step1(self._model, self._data)
        controller, first = self._version.controller(), np.empty(0)
        # A controller that was just created or moved keeps to what it saw then, for the next goal and torques.
        keeps = not controller.new_update
        if not keeps:
            getattr(controller, self._version.tool[1])[:] = self._arm.position
            getattr(controller, self._version.tool[2])[:] = self._arm.rotation
            controller.new_update = False  # A goal depends on nothing else.
        goal, commands = self._goal(controller, action)
        if keeps:
            first = controller.run_controller()
        controller.new_update = True
        self._law.physics_steps(goal, self._grip_middle + self._grip_half * commands, first, self._arm)

    def _goal(self, controller: Any, action: FloatArray) -> tuple[Any, FloatArray]:
        """Set the goal of an action and return it, and the gripper's commands."""
        position, rotation, commands = self._version.set_goal(controller, action, self._steps)
        gains = controller.kp, controller.kd
        return self._law.Goal(position, rotation, *gains, controller.initial_joint), commands

    def _bind(self, controller: Any, actuators: slice, grip: slice) -> Any:
        """Return views of MuJoCo's arrays, which stay where they are, and arrays of the layout of the controller's."""
        model, data = self._model, self._data
        site = model.site(getattr(controller, self._version.tool[0])).id
        dofs, jacobians, masses = (
            consecutive(controller.qvel_index),
            np.zeros((2, 3, model.nv)),
            np.zeros((model.nv,) * 2),
        )
        low, high = model.actuator_ctrlrange[actuators].T.copy()
        return self._law.Arm(
            model=model._address,
            data=data._address,
            packed_masses=data.qM.ctypes.data,
            masses_out=masses.ctypes.data,
            jacobians_out=(jacobians[0].ctypes.data, jacobians[1].ctypes.data),
            site=np.int32(site),
            position=data.site_xpos[site],
            rotation=data.site_xmat[site].reshape(3, 3),
            velocities=data.qvel,
            joints=data.qpos[consecutive(controller.qpos_index)],
            speeds=data.qvel[dofs],
            bias=data.qfrc_bias[dofs],
            control=data.ctrl[actuators],
            low=low,
            high=high,
            grip=data.ctrl[grip],
            jacobians=jacobians,
            arm_jacobians=jacobians[:, :, dofs],
            masses=masses[dofs, dofs],
            j_pos=np.empty_like(controller.J_pos),
            j_rot=np.empty_like(controller.J_ori),
            j_full=np.empty_like(controller.J_full),
            mass=np.empty_like(controller.mass_matrix),
        )

    def _agrees(self) -> bool:
        """Return whether robosuite's torques in random states are those of the compiled code."""
        generator, controller, arm = np.random.default_rng(0), self._version.controller(), self._arm
        start = arm.joints.copy()
        for _ in range(TRIALS):
            arm.joints[:] = start + generator.uniform(-0.5, 0.5, len(start))
            arm.velocities[:] = generator.normal(size=len(arm.velocities))
            self._mujoco.mj_forward(self._model, self._data)
            controller.new_update = True
            goal, _ = self._goal(controller, generator.uniform(-1.0, 1.0, self._env.action_dim))
            if not np.array_equal(controller.run_controller(), self._law.torques_towards(goal, arm)):
                return False
        return True


def consecutive(numbers: Sequence[int]) -> slice:
    """Return the slice of consecutive numbers, with which arrays give views."""
    start, end = numbers[0], numbers[0] + len(numbers)
    if list(numbers) != list(range(start, end)):
        raise ValueError(f"expected consecutive numbers, found {numbers}")
    return slice(start, end)
