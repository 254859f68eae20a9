"""Contacts and joint limits of the robot in ManiSkill."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

FINGERS = 2
"""Joints of the gripper, the last ones."""


class ManiSkillContacts:
    """Measures the force on the robot and the distance of its joints from their limits."""

    def __init__(self, robots: Iterable[Any], objects: Iterable[Any]) -> None:
        """Take SAPIEN's articulations and the entities of the task's objects."""
        self._robots = list(robots)
        self._links = {link for robot in self._robots for link in robot.links}
        self._touchable = self._links | {part for entity in objects for part in entity.components}
        limits = np.concatenate([robot.qlimits[:-FINGERS] for robot in self._robots])
        self._low, self._high = limits.T

    def contact_force(self, physics: Any) -> float:
        """Return the sum of normal forces between the robot and all but itself and the objects (N)."""
        total = 0.0
        for contact in physics.get_contacts():
            bodies = set(contact.bodies)
            if bodies & self._links and not bodies <= self._touchable:
                total += sum(_normal_impulse(point) for point in contact.points)
        return total / physics.timestep

    def joint_margin(self) -> float:
        """Return the smallest distance of the arm's joints from their limits, negative beyond one (rad)."""
        joints = np.concatenate([robot.qpos[:-FINGERS] for robot in self._robots])
        return float(np.minimum(joints - self._low, self._high - joints).min())


def _normal_impulse(point: Any) -> float:
    """Size of the impulse along the normal (N s); most points have none, since shapes that are close count."""
    impulse = point.impulse
    return abs(float(impulse @ point.normal)) if any(impulse.tolist()) else 0.0
