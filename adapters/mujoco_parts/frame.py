"""The frame of the robot's base in MuJoCo's world."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import relative_pose


class BaseFrame:
    """Converts points and poses between the base frame and MuJoCo's world."""

    def __init__(self, base: Any) -> None:
        """Take the body of the data that carries the robot."""
        self._base = base

    @property
    def rotation(self) -> Rotation:
        """The rotation from the base frame to the world."""
        return Rotation.from_matrix(self._base.xmat.reshape(3, 3))

    def to_world(self, point: FloatArray) -> FloatArray:
        """Convert a point (3,) of the base frame to the world."""
        return np.asarray(self.rotation.apply(point) + self._base.xpos)

    def from_world(self, point: FloatArray) -> FloatArray:
        """Convert a point (3,) of the world to the base frame."""
        return np.asarray(self.rotation.inv().apply(point - self._base.xpos))

    def pose_from_world(self, position: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Convert a world pose to the base frame.

        Args:
            position: Shape (3,), m.
            rotation: A quaternion xyzw (4,) or a matrix, row by row, (9,).

        Returns:
            Position (3,) and quaternion xyzw (4,).
        """
        quaternion = rotation if rotation.size == 4 else Rotation.from_matrix(rotation.reshape(3, 3)).as_quat()
        return relative_pose(self._base.xpos, self.rotation.as_quat(), position, quaternion)
