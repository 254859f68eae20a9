"""Moves the arm of ManiSkill's tasks to another start."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.maniskill.dynamics import renew_physics
from robogauntlet.adapters.scene_control import Unreachable

NEAR, ALIGNED = 1e-3, 0.01
"""Largest error of a pose (m, rad)."""
GLANCE = 1e-6
"""Duration of the physics step that finds contacts (s)."""


class ManiSkillArm:
    """`Arm` of `scene_control`. Uses the inverse kinematics of ManiSkill's own controller."""

    def __init__(self, env: Any, base_from_world: Any) -> None:
        """Take ManiSkill's environment, and SAPIEN's pose of the world in the base frame."""
        self._env, self._base_from_world = env, base_from_world

    def place_tool(self, position: FloatArray, quaternion: FloatArray) -> None:
        """Bring the tool, at rest, to a pose, until the next reset.

        Raises:
            Unreachable: The error would exceed 1 mm or 0.01 rad, or the robot would touch something.
        """
        own = self._robot.qpos, self._robot.qvel
        there = self._solve(position, quaternion), np.zeros_like(own[1])
        self._bring(*there)
        reason = self._missed(position, quaternion) or _touching(self._env)
        self._bring(*(own if reason else there))
        if reason:
            raise Unreachable(f"the tool cannot be brought to {np.round(position, 3).tolist()}: {reason}")

    @property
    def _robot(self) -> Any:
        """SAPIEN's articulation."""
        return self._env.agent.robot._objs[0]

    @property
    def _kinematics(self) -> Any:
        """ManiSkill's model of the arm, without the fingers."""
        return self._env.agent.controller.controllers["arm"].kinematics

    def _solve(self, position: FloatArray, quaternion: FloatArray) -> Any:
        """Return joint positions near the present ones that bring the tool closest to a pose. The fingers stay."""
        import sapien

        moved = self._kinematics.qmask.numpy()
        found, _, _ = self._kinematics.pmodel.compute_inverse_kinematics(
            self._kinematics.end_link_idx,
            sapien.Pose(position, np.roll(quaternion, 1)),
            initial_qpos=self._robot.qpos,
            active_qmask=moved,
            eps=1e-5,
            max_iterations=1000,
        )
        return np.where(moved, found, self._robot.qpos).astype(np.float32)

    def _bring(self, qpos: Any, qvel: Any) -> None:
        """Set joint positions and velocities, which the controllers then hold."""
        self._robot.set_qpos(qpos)
        self._robot.set_qvel(qvel)
        self._env.agent.controller.reset()

    def _missed(self, position: FloatArray, quaternion: FloatArray) -> str:
        """Return why the present pose is not acceptable; empty if it is."""
        low, high = self._robot.qlimits.T
        if ((self._robot.qpos < low) | (self._robot.qpos > high))[self._kinematics.qmask.numpy()].any():
            return "a joint would be beyond its limit"
        pose = self._base_from_world * self._env.agent.tcp._objs[0].entity_pose
        turn = Rotation.from_quat(wxyz_to_xyzw(pose.q)) * Rotation.from_quat(quaternion).inv()
        if np.linalg.norm(pose.p - position) > NEAR or turn.magnitude() > ALIGNED:
            return "out of reach"
        return ""


def _touching(env: Any) -> str:
    """Return a contact of the robot, with itself or another body; empty without contacts.

    PhysX finds contacts only when it steps, so it makes a very short step, which is undone; the joints have to be set
    again.
    """
    import sapien

    physics = env.scene.px
    bodies = physics.rigid_dynamic_components
    own = [(body.entity.pose, body.linear_velocity, body.angular_velocity) for body in bodies]
    timestep = physics.timestep
    physics.timestep = GLANCE
    physics.step()
    contacts = physics.get_contacts()
    physics.timestep = timestep
    for body, (pose, linear, angular) in zip(bodies, own, strict=True):
        body.entity.set_pose(pose)
        if not body.kinematic:
            body.linear_velocity, body.angular_velocity = linear, angular
    renew_physics(env)
    for contact in contacts:
        robot = [isinstance(body, sapien.physx.PhysxArticulationLinkComponent) for body in contact.bodies]
        if any(robot) and any(point.separation <= 0.0 for point in contact.points):
            first, second = (body.entity.name.removeprefix("scene-0_") for body in contact.bodies)
            return f"{first} would touch {second}"
    return ""
