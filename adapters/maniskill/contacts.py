"""Contacts and joint limits of the robot in ManiSkill."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

FINGERS = 2
"""Joints of the gripper, the last ones."""


class ManiSkillContacts:
    """Measures the force on the robot and the distance of its joints from their limits."""

    def __init__(self, robot: Any, objects: Iterable[Any]) -> None:
        """Take SAPIEN's articulation and the entities of the task's objects."""
        self._robot = robot
        self._links = {link.entity.name for link in robot.links}
        self._touchable = self._links | {entity.name for entity in objects}
        self._low, self._high = robot.qlimits[:-FINGERS].T

    def contact_force(self, physics: Any) -> float:
        """Return the sum of normal forces between the robot and all but itself and the objects (N)."""
        total = 0.0
        for contact in physics.get_contacts():
            names = {body.entity.name for body in contact.bodies}
            if names & self._links and not names <= self._touchable:
                total += sum(abs(float(point.impulse @ point.normal)) for point in contact.points)
        return total / physics.timestep

    def joint_margin(self) -> float:
        """Return the smallest distance of the arm's joints from their limits, negative beyond one (rad)."""
        joints = self._robot.qpos[:-FINGERS]
        return float(np.minimum(joints - self._low, self._high - joints).min())
