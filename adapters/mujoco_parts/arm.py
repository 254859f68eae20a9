"""Brings an arm of robosuite's to where an episode is to start."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.adjusting import Unreachable
from adapters.contract import FloatArray
from adapters.mujoco_parts.frame import BaseFrame

NEAR, ALIGNED = 1e-3, 1e-2
"""How well a pose has to be met (m, rad)."""
DAMPING, STRIDE, ROUNDS = 1e-4, 0.1, 200
"""Of the inverse kinematics: what is added to J J', the most that a round corrects (m, rad), and how many there are."""


class MujocoArm:
    """See `adapters.adjusting.Arm`. Every reset puts the arm where it starts, with new controllers: nothing to undo."""

    turns = True

    def __init__(
        self,
        mujoco: Any,
        simulator: tuple[Any, Any],
        controller: Callable[[], Any],
        tool: tuple[str, str],
        frame: BaseFrame,
        settle: Callable[[], None],
    ) -> None:
        """Take the arm.

        Args:
            mujoco: The module.
            simulator: MuJoCo's model and data.
            controller: robosuite's of the arm, whenever asked: resets make a new one.
            tool: Names of the tool centre point's site and of the hand's body.
            frame: The robot's base.
            settle: Brings forces and contacts up to date.
        """
        self._mujoco, self._controller, self._frame, self._settle = mujoco, controller, frame, settle
        self._model, self._data = simulator
        self._site, self._hand = self._model.site(tool[0]).id, self._model.body(tool[1]).id
        arm = controller()
        self._joints, self._qpos, self._dofs = arm.joint_index, arm.qpos_index, arm.qvel_index
        self._scratch: Any = None
        """Data to try joint positions on, made on first use."""

    def place_tool(self, position: FloatArray, quaternion: FloatArray) -> None:
        """Bring the arm, at rest, to a pose of the tool, until the next reset.

        Raises:
            Unreachable: It cannot be met to within 1 mm and 0.01 rad, or something would be touched.
        """
        goal = self._frame.to_world(np.asarray(position)), self._frame.rotation * Rotation.from_quat(quaternion)
        joints, error = self._reach(*goal)
        where = ", ".join(f"{value:.3f}" for value in position)
        off, turned = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        if off > NEAR or turned > ALIGNED:
            raise Unreachable(
                f"no tool pose at ({where}) m within 1 mm and 0.01 rad: off by {off:.3f} m, {turned:.3f} rad"
            )
        touched = self._touched()
        if touched:
            raise Unreachable(f"no tool pose at ({where}) m: {touched} would touch")
        self._data.qpos[self._qpos], self._data.qvel[self._dofs] = joints, 0.0
        # The controller pulls idle joints to where it believes the arm to have started. Resets make a new one.
        self._controller().update_initial_joints(joints)
        self._settle()

    def _reach(self, position: FloatArray, rotation: Rotation) -> tuple[FloatArray, FloatArray]:
        """Joint positions nearby that bring the tool to a pose of the world, and what is left of the way, (6,).

        Damped least squares within the joints' limits, from where the arm is (Wampler 1986).
        """
        if self._scratch is None:
            self._scratch = self._mujoco.MjData(self._model)
        scratch, (low, high) = self._scratch, self._model.jnt_range[self._joints].T
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
            way = np.linalg.solve(arm @ arm.T + DAMPING * np.eye(6), error * min(1.0, STRIDE / size))
            scratch.qpos[self._qpos] = np.clip(scratch.qpos[self._qpos] + arm.T @ way, low, high)
        return scratch.qpos[self._qpos], error

    def _touched(self) -> str:
        """The first contact of the robot at the joint positions tried, with itself or another thing; empty if none."""
        self._mujoco.mj_fwdPosition(self._model, self._scratch)
        robot = self._model.body_rootid[self._hand]
        for pair in self._scratch.contact.geom:
            if robot in self._model.body_rootid[self._model.geom_bodyid[pair]]:
                return " and ".join(self._model.geom(geom).name for geom in pair)
        return ""
