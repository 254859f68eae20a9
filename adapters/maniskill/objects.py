"""Moves the objects of ManiSkill's tasks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.scene_control import PlacementRegion


class ManiSkillObjects:
    """`Objects` of `scene_control`. The cubes can be moved, a goal region cannot."""

    def __init__(self, objects: Mapping[str, Any], spread: tuple[float, float], base_from_world: Any) -> None:
        """Take SAPIEN's entities by name, and its pose of the world in the base frame.

        `spread` is the largest distance of a centre from the world's origin after a reset, along x and y (m).
        """
        self._objects = objects
        self._turn = Rotation.from_quat(wxyz_to_xyzw(base_from_world.q))
        corners = np.array([[-spread[0], -spread[1], 0.0], [spread[0], spread[1], 0.0]])
        corners = (self._turn.apply(corners) + base_from_world.p)[:, :2]
        self._box = PlacementRegion(corners.min(axis=0), corners.max(axis=0))

    def placeable(self) -> Mapping[str, PlacementRegion]:
        """Return the region of the objects, which is the same for all."""
        return dict.fromkeys(self._objects, self._box)

    def move(self, name: str, offset: FloatArray) -> None:
        """Move an object by an offset (2,), until the next reset."""
        import sapien

        pose = self._objects[name].pose
        self._objects[name].set_pose(sapien.Pose(pose.p + self._turn.inv().apply([*offset, 0.0]), pose.q))
