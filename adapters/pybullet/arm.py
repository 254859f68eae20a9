"""The arm of the PyBullet adapter, which can start elsewhere. A reset brings it back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.adjusting import Unreachable
from adapters.contract import FloatArray
from adapters.pybullet.frame import BASE_IN_WORLD, tool_pose

ROUNDS = 100
"""How often inverse kinematics, of 20 iterations each, is called at most."""
CONVERGED = 1e-5
"""Distance and angle at which it is good enough (m, rad)."""
TOLERANCE = 1e-3
"""Distance beyond which a pose is not met (m)."""
ANGLE_TOLERANCE = 0.01
"""Angle beyond which a pose is not met (rad)."""
JOINTS = range(7)
FIXED_LINK = -1
"""The robot's base, which stands on the table."""


class PyBulletArm:
    """See `adapters.adjusting.Arm`. panda-gym's controller keeps the gripper pointing down, so it cannot turn."""

    turns = False

    def __init__(self, env: Any, hold: Callable[[FloatArray], None]) -> None:
        """Of an unwrapped panda-gym environment, with what makes the controller stay at a tool position (3,)."""
        self._env, self._hold = env, hold
        self._client, self._robot = env.sim.physics_client, env.robot
        self._body = env.sim._bodies_idx["panda"]
        limits = [self._client.getJointInfo(self._body, joint)[8:10] for joint in JOINTS]
        self._low, self._high = np.array(limits).T

    def place_tool(self, position: FloatArray, quaternion: FloatArray) -> None:
        """Bring the arm to a tool pose, until the next reset.

        Raises:
            Unreachable: It turns the tool, or cannot be met without touching something.
        """
        turn = _angle(tool_pose(self._env)[1], quaternion)
        if turn > ANGLE_TOLERANCE:
            raise Unreachable(f"the arm cannot turn its tool in PyBullet; {turn:.3f} rad were asked for")
        before = self._client.getJointStates(self._body, JOINTS)
        self._solve(position, quaternion)
        obstacle = self._obstacle(position, quaternion)
        if obstacle:
            for joint, (angle, velocity, *_) in zip(JOINTS, before, strict=True):
                self._client.resetJointState(self._body, joint, angle, velocity)
            raise Unreachable(f"the tool cannot be brought to {np.round(position, 3).tolist()} m: {obstacle}")
        self._hold(tool_pose(self._env)[0])

    def _solve(self, position: FloatArray, quaternion: FloatArray) -> None:
        """Move the joints towards a tool pose for as long as that helps."""
        for _ in range(ROUNDS):
            angles = self._robot.inverse_kinematics(self._robot.ee_link, position + BASE_IN_WORLD, quaternion)
            for joint in JOINTS:
                self._client.resetJointState(self._body, joint, angles[joint])
            if max(self._missed(position, quaternion)) < CONVERGED:
                return

    def _missed(self, position: FloatArray, quaternion: FloatArray) -> tuple[float, float]:
        """How far the tool is from a pose (m, rad)."""
        reached, orientation = tool_pose(self._env)
        return float(np.linalg.norm(reached - position)), _angle(orientation, quaternion)

    def _obstacle(self, position: FloatArray, quaternion: FloatArray) -> str:
        """What is wrong with the arm where it is now; nothing if it is where it should be and free."""
        distance, angle = self._missed(position, quaternion)
        if distance > TOLERANCE or angle > ANGLE_TOLERANCE:
            return f"it is {1000 * distance:.1f} mm and {angle:.3f} rad out of reach"
        angles = np.array([state[0] for state in self._client.getJointStates(self._body, JOINTS)])
        if (angles < self._low).any() or (angles > self._high).any():
            return "a joint would be beyond its limits"
        touched = [name for name, body in self._env.sim._bodies_idx.items() if self._touches(body)]
        return f"the arm would touch the {touched[0]}" if touched else ""

    def _touches(self, body: int) -> bool:
        if body == self._body:
            return False
        return any(point[3] != FIXED_LINK for point in self._client.getClosestPoints(self._body, body, 0.0))


def _angle(one: FloatArray, other: FloatArray) -> float:
    return float((Rotation.from_quat(one) * Rotation.from_quat(other).inv()).magnitude())
