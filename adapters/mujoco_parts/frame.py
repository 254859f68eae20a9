"""The frame of the robot's base in MuJoCo's world."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray


class BaseFrame:
    """Converts points and directions between the base frame and MuJoCo's world."""

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
