"""Moves robosuite's arms to another start."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.scene_control import Unreachable

NEAR, ALIGNED = 1e-3, 1e-2
"""Largest error of a pose (m, rad)."""
DAMPING, STRIDE, ROUNDS = 1e-4, 0.1, 200
"""Inverse kinematics: term added to J J', largest correction in a round (m, rad), number of rounds."""


class MujocoArm:
    """An `Arm` of `scene_control`. Every reset places the arm and creates its controllers, so there is no `undo`."""

    def __init__(self, physics: MujocoPhysics, controller: Callable[[], Any], tool: tuple[str, str]) -> None:
        """Take the names of the tool centre point's site and of the hand's body.

        `controller` returns robosuite's present controller, of which resets create a new one.
        """
        self._physics, self._controller = physics, controller
        self._mujoco, self._model, self._data = physics.mujoco, physics.model, physics.data
        self._site, self._hand = self._model.site(tool[0]).id, self._model.body(tool[1]).id
        arm = controller()
        self._joints, self._qpos, self._dofs = arm.joint_index, arm.qpos_index, arm.qvel_index
        self._of_gripper = below(self._model, self._hand)
        self._scratch: Any = None
        """Data on which joint positions are tried, created at first use."""

    def place_tool(self, position: FloatArray, quaternion: FloatArray) -> None:
        """Bring the tool, at rest, to a pose, until the next reset.

        Raises:
            Unreachable: The error would exceed 1 mm or 0.01 rad, or something would be touched.
        """
        goal = self._physics.to_world(np.asarray(position)), self._physics.rotation * Rotation.from_quat(quaternion)
        joints, error = self._reach(*goal)
        where = ", ".join(f"{value:.3f}" for value in position)
        distance, angle = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        if distance > NEAR or angle > ALIGNED:
            raise Unreachable(
                f"no tool pose at ({where}) m within 1 mm and 0.01 rad: off by {distance:.3f} m, {angle:.3f} rad"
            )
        contact = self._contact()
        if contact:
            raise Unreachable(f"no tool pose at ({where}) m: {contact} would touch")
        self._data.qpos[self._qpos], self._data.qvel[self._dofs] = joints, 0.0
        # The controller pulls idle joints to their initial positions. Resets create a new one.
        self._controller().update_initial_joints(joints)
        self._physics.settle()

    def _reach(self, position: FloatArray, rotation: Rotation) -> tuple[FloatArray, FloatArray]:
        """Return nearby joint positions that bring the tool to a world pose, and the remaining error (6,).

        Damped least squares within the joints' limits, from the present position (Wampler 1986).
        """
        if self._scratch is None:
            self._scratch = self._mujoco.MjData(self._model)
        scratch, (low, high) = self._scratch, self._model.jnt_range[self._joints].T.copy()
        endless = self._model.jnt_limited[self._joints] == 0
        low[endless], high[endless] = -np.inf, np.inf
        scratch.qpos[:] = self._data.qpos
        jacobian = np.zeros((6, self._model.nv))
        for _ in range(ROUNDS):
            self._mujoco.mj_kinematics(self._model, scratch)
            hand = Rotation.from_matrix(scratch.xmat[self._hand].reshape(3, 3))
            error = np.concatenate([position - scratch.site_xpos[self._site], (rotation * hand.inv()).as_rotvec()])
            size = float(np.linalg.norm(error))
            if size < 1e-8:
                break
            self._mujoco.mj_comPos(self._model, scratch)
            self._mujoco.mj_jacSite(self._model, scratch, jacobian[:3], jacobian[3:], self._site)
            arm = jacobian[:, self._dofs]
            step = np.linalg.solve(arm @ arm.T + DAMPING * np.eye(6), error * min(1.0, STRIDE / size))
            scratch.qpos[self._qpos] = np.clip(scratch.qpos[self._qpos] + arm.T @ step, low, high)
        return scratch.qpos[self._qpos], error

    def _contact(self) -> str:
        """Return the first contact of the robot, with itself or another body, at the positions tried; empty if none.

        Parts of the gripper touch each other in any pose.
        """
        self._mujoco.mj_fwdPosition(self._model, self._scratch)
        robot = self._model.body_rootid[self._hand]
        for pair in self._scratch.contact.geom:
            bodies = self._model.geom_bodyid[pair]
            if robot in self._model.body_rootid[bodies] and not all(self._of_gripper[bodies]):
                return " and ".join(self._model.geom(geom).name for geom in pair)
        return ""


def below(model: Any, body: int) -> NDArray[np.bool_]:
    """Return which bodies hang from a body, itself included, (bodies,)."""
    found = np.zeros(model.nbody, dtype=bool)
    found[body] = True
    for number in range(body + 1, model.nbody):  # Parents come before their children.
        found[number] = found[model.body_parentid[number]]
    return found
