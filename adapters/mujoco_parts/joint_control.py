"""Moves arms of robosuite by the targets or velocities of their joints.

robosuite's JOINT_VELOCITY cannot be built in its version 1.5.2 (it sets a property without setter), and its
JOINT_POSITION lags behind a target that moves. Here both kinds of actions move a target, evenly within a control step,
and each physics step has JOINT_POSITION's torques with the target's own velocity:

    torques = M (kp (q_d - q) + kd (v_d - v)) + bias

with the arm's mass matrix M, joints q, their velocities v, and those of the target, q_d and v_d. A gripper's command is
a target as well: its fingers follow it at the speed that robosuite gives them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import ActionSpec, FloatArray, Joint
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics

STIFFNESS = 150.0
"""kp (1/s^2), that of robosuite's own controller of tools; kd is that of critical damping."""
DAMPING = 2.0 * np.sqrt(STIFFNESS)
STEP = 0.2
"""Largest change of a joint's target in a control step (rad): at DROID's 15 Hz, 3 rad/s."""
ENDLESS = 2.0 * np.pi
"""Bounds of the targets of joints without limits (rad)."""


def joints_of(robot: Any, model: Any) -> tuple[Joint, ...]:
    """Return the joints of a robot of robosuite as `joint_1` and so on, with the limits of MuJoCo's model."""
    numbers = [model.joint(name).id for name in robot.robot_joints]
    limits = [model.jnt_range[n] if model.jnt_limited[n] else (-ENDLESS, ENDLESS) for n in numbers]
    return tuple(Joint(f"joint_{n}", float(low), float(high), STEP) for n, (low, high) in enumerate(limits, 1))


class JointControl:
    """Runs control steps of one arm or two. It is the controller of which `MujocoArm` moves the start."""

    def __init__(self, physics: MujocoPhysics, robots: Sequence[Any], spec: ActionSpec) -> None:
        """Take robosuite's robots, and set MuJoCo's physics step so that a control step has a whole number of them."""
        self._mujoco, self._model, self._data, self._spec = physics.mujoco, physics.model, physics.data, spec
        self._steps = round(1.0 / spec.control_hz / self._model.opt.timestep)
        self._model.opt.timestep = 1.0 / spec.control_hz / self._steps
        self.joint_index, self.qpos_index, self.qvel_index = (
            np.concatenate([getattr(robot, f"_ref_joint{kind}_indexes") for robot in robots])
            for kind in ("", "_pos", "_vel")
        )
        actuators = [robot._ref_actuators_indexes_dict for robot in robots]
        self._motors = np.concatenate([own["right"] for own in actuators])
        self._grips = [np.array(own["right_gripper"]) for own in actuators]
        self._closing = [_closing(robot.gripper["right"]) for robot in robots]
        self._speeds = np.array([robot.gripper["right"].speed for robot in robots])
        self._ends = np.array([[-1.0, 1.0]] * len(robots))
        """Where the fingers of each arm are when it is open and when it is closed: springs hold them back."""
        self._masses, self._square = np.zeros((self._model.nv,) * 2), np.ix_(self.qvel_index, self.qvel_index)
        low, high = np.array([(joint.low, joint.high) for joint in spec.joints] * spec.arms).T
        self._bounds, self._largest = (low, high), np.array([joint.step for joint in spec.joints] * spec.arms)
        self._places = [index for arm in range(spec.arms) for index in range(len(spec.names))[spec.joints_of(arm)]]
        self._grip_places = [spec.joints_of(arm).stop for arm in range(spec.arms)]
        self.begin()

    def begin(self) -> None:
        """Take the present joints and grippers as targets, after a reset."""
        self._targets = self._data.qpos[self.qpos_index].copy()
        self._closed = np.concatenate([self.gripper(arm) for arm in range(self._spec.arms)])

    def update_initial_joints(self, joints: FloatArray) -> None:
        """Take joints, to which the arm was moved, as targets."""
        self._targets = np.array(joints)

    def targets(self, arm: int) -> FloatArray:
        """Return the present targets of an arm's joints (n,), rad."""
        return np.array(np.split(self._targets, self._spec.arms)[arm])

    def angles(self, arm: int) -> FloatArray:
        """Return the angles of an arm's joints (n,), rad."""
        return np.array(np.split(self._data.qpos[self.qpos_index], self._spec.arms)[arm])

    def take_gripper_ends(self, place: int) -> None:
        """Take the present fingers of empty grippers as open (0) or closed (1), rounded so that processors agree."""
        self._ends[:, place] = [round(self._fingers(arm), 4) for arm in range(self._spec.arms)]

    def gripper(self, arm: int) -> FloatArray:
        """Return how far an arm's gripper is closed (1,), from -1 (open) to 1."""
        opened, closed = self._ends[arm]
        return np.clip([2.0 * (self._fingers(arm) - opened) / (closed - opened) - 1.0], -1.0, 1.0)

    def _fingers(self, arm: int) -> float:
        """Return the mean place of an arm's fingers within the range of their commands, from -1 to 1."""
        low, high = self._model.actuator_ctrlrange[self._grips[arm]].T
        fingers = self._data.qpos[self._model.jnt_qposadr[self._model.actuator_trnid[self._grips[arm], 0]]]
        return float(np.mean(self._closing[arm] * (2.0 * (fingers - low) / (high - low) - 1.0)))

    def state(self) -> dict[str, FloatArray]:
        """Return what the next steps depend on besides MuJoCo's positions and velocities, for the state's hash."""
        return {"targets": self._targets, "closed": self._closed}

    def step(self, action: FloatArray) -> None:
        """Run the physics steps of one control step. `action` is within the bounds of the action spec."""
        begin, moved = self._targets, action[self._places]
        change = moved / self._spec.control_hz if self._spec.velocities else moved - begin
        self._targets = np.clip(begin + np.clip(change, -self._largest, self._largest), *self._bounds)
        self._closed = self._closed + np.clip(action[self._grip_places] - self._closed, -self._speeds, self._speeds)
        model, data, mujoco = self._model, self._data, self._mujoco
        for grips, closing, closed in zip(self._grips, self._closing, self._closed, strict=True):
            low, high = model.actuator_ctrlrange[grips].T
            data.ctrl[grips] = low + (closing * closed + 1.0) / 2.0 * (high - low)
        low, high = model.actuator_ctrlrange[self._motors].T
        change = self._targets - begin
        velocity = change * self._spec.control_hz
        for number in range(1, self._steps + 1):
            mujoco.mj_step1(model, data)
            mujoco.mj_fullM(model, self._masses, data.qM)
            error = begin + change * (number / self._steps) - data.qpos[self.qpos_index]
            wanted = STIFFNESS * error + DAMPING * (velocity - data.qvel[self.qvel_index])
            torques = self._masses[self._square] @ wanted + data.qfrc_bias[self.qvel_index]
            data.ctrl[self._motors] = np.minimum(np.maximum(torques, low), high)
            mujoco.mj_step2(model, data)


def _closing(gripper: Any) -> FloatArray:
    """Return the sign of each actuator of robosuite's gripper as it closes."""
    gripper.current_action = np.zeros(gripper.dof)
    return np.sign(gripper.format_action(np.ones(gripper.dof)))
