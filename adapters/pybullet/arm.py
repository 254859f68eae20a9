"""Moves the arm of panda-gym's tasks to another start."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.scene_control import Unreachable

BASE_IN_WORLD = np.array([-0.6, 0.0, 0.0])
"""Position of the robot's base, which is not rotated, in the world of panda-gym (m)."""
ROUNDS = 100
"""Most calls of the inverse kinematics, of 20 iterations each."""
CONVERGED = 1e-5
"""Distance and angle at which it has converged (m, rad)."""
TOLERANCE, ANGLE_TOLERANCE = 1e-3, 0.01
"""Largest distance and angle from a pose (m, rad)."""
JOINTS = range(7)
FIXED_LINK = -1
"""The robot's base, which stands on the table."""


def tool_pose(env: Any) -> tuple[FloatArray, FloatArray]:
    """Position (m, base frame) and quaternion xyzw of the point between the fingertips of a panda-gym environment."""
    link = env.sim.physics_client.getLinkState(env.sim._bodies_idx["panda"], env.robot.ee_link)
    return np.array(link[0]) - BASE_IN_WORLD, np.array(link[1])


def joint_limits(env: Any) -> FloatArray:
    """Lowest and highest positions of the arm's joints in a panda-gym environment, shape (2, 7) (rad)."""
    client, body = env.sim.physics_client, env.sim._bodies_idx["panda"]
    return np.array([client.getJointInfo(body, joint)[8:10] for joint in JOINTS]).T


class PyBulletArm:
    """`Arm` of `scene_control`.

    panda-gym's controller keeps the gripper pointing down, or as it was placed. Actions do not turn it.
    """

    def __init__(self, env: Any, hold: Callable[[FloatArray], None]) -> None:
        """Take an unwrapped panda-gym environment, and a function that makes the controller hold a position (3,)."""
        self._env, self._hold = env, hold
        self._client, self._robot = env.sim.physics_client, env.robot
        self._body = env.sim._bodies_idx["panda"]
        self._low, self._high = joint_limits(env)

    def place_tool(self, position: FloatArray, quaternion: FloatArray) -> None:
        """Bring the arm to a tool pose, until the next reset.

        Raises:
            Unreachable: The tool would miss the pose, or touch something.
        """
        before = self._client.getJointStates(self._body, JOINTS)
        self._solve(position, quaternion)
        obstacle = self._obstacle(position, quaternion)
        if obstacle:
            for joint, (angle, velocity, *_) in zip(JOINTS, before, strict=True):
                self._client.resetJointState(self._body, joint, angle, velocity)
            raise Unreachable(f"the tool cannot be brought to {np.round(position, 3).tolist()} m: {obstacle}")
        self._hold(tool_pose(self._env)[0])
        solve = type(self._robot).inverse_kinematics
        self._robot.inverse_kinematics = lambda link, position, orientation: solve(
            self._robot, link, position, quaternion
        )

    def undo(self) -> None:
        """Let the controller keep the gripper pointing down."""
        vars(self._robot).pop("inverse_kinematics", None)

    def _solve(self, position: FloatArray, quaternion: FloatArray) -> None:
        """Move the joints to a tool pose, until the inverse kinematics converges."""
        for _ in range(ROUNDS):
            angles = self._robot.inverse_kinematics(self._robot.ee_link, position + BASE_IN_WORLD, quaternion)
            for joint in JOINTS:
                self._client.resetJointState(self._body, joint, angles[joint])
            if max(self._missed(position, quaternion)) < CONVERGED:
                return

    def _missed(self, position: FloatArray, quaternion: FloatArray) -> tuple[float, float]:
        """Return the tool's distance and angle from a pose (m, rad)."""
        reached, orientation = tool_pose(self._env)
        return float(np.linalg.norm(reached - position)), _angle(orientation, quaternion)

    def _obstacle(self, position: FloatArray, quaternion: FloatArray) -> str:
        """Return why the present pose is not acceptable; empty if it is."""
        distance, angle = self._missed(position, quaternion)
        if distance > TOLERANCE or angle > ANGLE_TOLERANCE:
            return f"it is {1000 * distance:.1f} mm and {angle:.3f} rad out of reach"
        angles = np.array([state[0] for state in self._client.getJointStates(self._body, JOINTS)])
        if (angles < self._low).any() or (angles > self._high).any():
            return "a joint would be beyond its limits"
        for name, body in self._env.sim._bodies_idx.items():
            points = self._client.getClosestPoints(self._body, body, 0.0) if body != self._body else ()
            if any(point[3] != FIXED_LINK for point in points):
                return f"the arm would touch the {name}"
        return ""


def _angle(first: FloatArray, other: FloatArray) -> float:
    return float((Rotation.from_quat(first) * Rotation.from_quat(other).inv()).magnitude())
