"""Contacts and joint limits of a robot in MuJoCo."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics

_ROBOT, _OBJECT = 1, 4
"""Weights of shapes: the sum over the two of a contact is `_ROBOT` for the robot and neither itself nor an object."""


class MujocoContacts:
    """Measures the force on a robot and the distance of its joints from their limits."""

    def __init__(
        self, physics: MujocoPhysics, bases: Iterable[str], fingers: Iterable[str], objects: Iterable[str]
    ) -> None:
        """Take the names of the base body of each arm, of the fingers' joints and of the bodies of the objects."""
        model = physics.model
        self._physics = physics
        roots = model.body_rootid
        robot_roots = [roots[model.body(base).id] for base in bases]
        object_roots = [roots[model.body(name).id] for name in objects]
        root = roots[model.geom_bodyid]
        weights = _ROBOT * np.isin(root, robot_roots) + _OBJECT * np.isin(root, object_roots)
        self._weights: list[int] = weights.tolist()
        of_arm = np.isin(roots[model.jnt_bodyid], robot_roots) & (model.jnt_limited != 0)
        of_arm[[model.joint(name).id for name in fingers]] = False
        self._joints = model.jnt_qposadr[of_arm]
        self._limits: list[tuple[float, float]] = model.jnt_range[of_arm].tolist()
        self._force = np.zeros(6)

    def contact_force(self) -> float:
        """Return the sum of normal forces between the robot and all but itself and the objects (N)."""
        mujoco, model, data = self._physics.mujoco, self._physics.model, self._physics.data
        if not data.ncon:
            return 0.0
        total, weights = 0.0, self._weights
        for contact, (one, other) in enumerate(data.contact.geom.tolist()):
            if weights[one] + weights[other] == _ROBOT:
                mujoco.mj_contactForce(model, data, contact, self._force)
                total += float(self._force[0])
        return total

    def joint_margin(self) -> float:
        """Return the smallest distance of the arm's joints from their limits, negative beyond one (rad)."""
        joints = self._physics.data.qpos[self._joints].tolist()
        return min(min(q - low, high - q) for q, (low, high) in zip(joints, self._limits, strict=True))
