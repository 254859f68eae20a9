"""An arm of ManiSkill's tasks: commands it, and reads it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import ARM_PREFIXES, FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw

CONTROLLER_RANGE = 0.1
"""Meaning of 1.0 in ManiSkill's controller: metres per axis, radians of the whole rotation."""


def robots_of(env: Any) -> list[ManiSkillRobot]:
    """Return the arms of ManiSkill's environment, in its order."""
    agents = getattr(env.agent, "agents", [env.agent])
    return [ManiSkillRobot(agent, ARM_PREFIXES[place], float(env.control_freq)) for place, agent in enumerate(agents)]


class ManiSkillRobot:
    """One arm with its gripper. Poses are in the frame of its base."""

    def __init__(self, agent: Any, prefix: str, control_hz: float) -> None:
        """Take ManiSkill's agent, one of `ARM_PREFIXES`, and the number of control steps per second."""
        self._agent, self._prefix = agent, prefix
        self.articulation = agent.robot._objs[0]
        self._tcp = agent.tcp._objs[0]
        arm = agent.controller.controllers["arm"]
        # A spring k with a damper d leaves exp(-k/d t) of the offset.
        share = 1.0 - np.exp(-arm.config.stiffness / arm.config.damping / control_hz)
        self._gain = 1.0 / share
        self.reach = CONTROLLER_RANGE * share
        """Largest translation (m) and rotation (rad) of a control step."""
        self.base_from_world = self.articulation.pose.inv()
        self._base_inverse = arm.root_link.pose.inv()

    def command(self, action: FloatArray) -> None:
        """Set the joints' targets by an action (7,).

        ManiSkill's own `step` finds the tool's pose in the base frame twice.
        """
        command = _command(action, self._gain)
        arm, gripper = (self._agent.controller.controllers[part] for part in ("arm", "gripper"))
        target = arm.compute_target_pose(self._base_inverse * arm.ee_pose, arm._preprocess_action(command[:, :6]))
        joints = arm.kinematics.compute_ik(target, arm.articulation.get_qpos())
        arm.set_drive_targets(arm.qpos if joints is None else joints)
        gripper.set_action(command[:, 6:])

    def state(self) -> dict[str, FloatArray]:
        """Return the entries that every `privileged_state` has of an arm."""
        position, quaternion = self.pose(self._tcp.entity_pose)
        prefix = self._prefix
        return {
            f"{prefix}tcp_position": position,
            f"{prefix}tcp_quaternion": quaternion,
            f"{prefix}finger_positions": self.articulation.qpos[-2:].astype(np.float64),
        }

    def tool_position(self) -> FloatArray:
        """Return `tcp_position`, (3,), without the rest."""
        return self.position(self._tcp.entity_pose)

    def opening(self) -> float:
        """Return the distance between the fingers (m)."""
        first, second = self.articulation.qpos[-2:].tolist()
        return float(first + second)

    def pose(self, pose: Any) -> tuple[FloatArray, FloatArray]:
        """Convert a SAPIEN pose in the world to position (3,) and quaternion xyzw (4,)."""
        pose = self.base_from_world * pose
        return pose.p.astype(np.float64), wxyz_to_xyzw(pose.q)

    def position(self, pose: Any) -> FloatArray:
        """Convert a SAPIEN pose in the world to its position (3,) (m)."""
        return np.array((self.base_from_world * pose).p, dtype=np.float64)


def _command(action: FloatArray, gain: float) -> Any:
    """Convert an action (7,) to ManiSkill's normalised one, a tensor (1, 7)."""
    import torch

    command = np.empty((1, 7), dtype=np.float32)
    command[0, :3] = gain / CONTROLLER_RANGE * action[:3]
    # The controller scales rotations by its lower bound, which reverses their sign.
    command[0, 3:6] = _euler_xyz(*(gain * action[3:6]).tolist(), longest=CONTROLLER_RANGE)
    command[0, 3:6] /= -CONTROLLER_RANGE
    command[0, 6] = -action[6]
    return torch.from_numpy(command)


def _euler_xyz(x: float, y: float, z: float, *, longest: float) -> tuple[float, float, float]:
    """Return Euler angles about x, y', z'' of an axis-angle vector, which is shortened to `longest` (rad) first.

    Plain floats, since SciPy's general conversion takes a tenth of the time of the physics.
    """
    angle = math.hypot(x, y, z)
    if angle < 1e-9:
        return 0.0, 0.0, 0.0
    half = 0.5 * min(angle, longest)
    sine, w = math.sin(half) / angle, math.cos(half)
    x, y, z = x * sine, y * sine, z * sine
    return (
        math.atan2(2 * (x * w - y * z), 1 - 2 * (x * x + y * y)),
        math.asin(2 * (x * z + y * w)),
        math.atan2(2 * (z * w - x * y), 1 - 2 * (y * y + z * z)),
    )
