"""The frame of the robot's base in MuJoCo's worlds."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.contract import FloatArray


class BaseFrame:
    """Takes points and directions from the base frame to MuJoCo's world, and back."""

    def __init__(self, base: Any) -> None:
        """Args: base: the body (of the data) that the robot stands on."""
        self._base = base

    @property
    def rotation(self) -> Rotation:
        """Turns directions of the base frame into those of the world."""
        return Rotation.from_matrix(self._base.xmat.reshape(3, 3))

    def to_world(self, point: FloatArray) -> FloatArray:
        """A point (3,) of the base frame, in the world's."""
        return np.asarray(self.rotation.apply(point) + self._base.xpos)

    def from_world(self, point: FloatArray) -> FloatArray:
        """A point (3,) of the world's frame, in the base's."""
        return np.asarray(self.rotation.inv().apply(point - self._base.xpos))
