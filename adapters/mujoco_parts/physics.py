"""The physics of a MuJoCo simulation, which its scene controls share."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import relative_pose


class MujocoPhysics:
    """MuJoCo's module, model and data, and the frame of the robot's base."""

    def __init__(self, mujoco: Any, model: Any, data: Any, base: str) -> None:
        """Take the module, model and data, and the name of the body that carries the robot."""
        self.mujoco, self.model, self.data = mujoco, model, data
        self.base = data.body(base)

    def settle(self) -> None:
        """Bring contacts and forces up to date after a reset or a change, with a cold start of the solver.

        The reset itself solves contacts of the last episode's fixtures or of default poses, from which the solver would
        otherwise start.
        """
        self.data.qacc_warmstart[:] = 0.0
        self.mujoco.mj_forward(self.model, self.data)

    @property
    def rotation(self) -> Rotation:
        """The rotation from the base frame to the world."""
        return Rotation.from_matrix(self.base.xmat.reshape(3, 3))

    def to_world(self, point: FloatArray) -> FloatArray:
        """Convert a point (3,) of the base frame to the world."""
        return np.asarray(self.rotation.apply(point) + self.base.xpos)

    def from_world(self, point: FloatArray) -> FloatArray:
        """Convert a point (3,) of the world to the base frame."""
        return np.asarray(self.rotation.inv().apply(point - self.base.xpos))

    def pose_from_world(self, position: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Convert a world pose to position (3,) and quaternion xyzw (4,) in the base frame.

        `rotation` is a quaternion xyzw (4,) or a matrix, row by row, (9,).
        """
        quaternion = rotation if rotation.size == 4 else Rotation.from_matrix(rotation.reshape(3, 3)).as_quat()
        return relative_pose(self.base.xpos, self.rotation.as_quat(), position, quaternion)
