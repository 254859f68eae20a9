"""Puts the things of ManiSkill's tasks elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.scene_control import PlacementRegion


class ManiSkillObjects:
    """See `adapters.scene_control.Objects`. The cubes can be moved; a goal region stays where the reset put it."""

    def __init__(self, things: Mapping[str, Any], spread: tuple[float, float], base_from_world: Any) -> None:
        """Remember what can be moved.

        Args:
            things: Our name to SAPIEN's entity.
            spread: Resets put each centre within this of the world's origin, along x and y (m).
            base_from_world: SAPIEN pose.
        """
        self._things = things
        self._turn = Rotation.from_quat(wxyz_to_xyzw(base_from_world.q))
        corners = np.array([[-spread[0], -spread[1], 0.0], [spread[0], spread[1], 0.0]])
        corners = (self._turn.apply(corners) + base_from_world.p)[:, :2]
        self._box = PlacementRegion(corners.min(axis=0), corners.max(axis=0))

    def placeable(self) -> Mapping[str, PlacementRegion]:
        """What can be moved, and where resets put it."""
        return dict.fromkeys(self._things, self._box)

    def move(self, name: str, offset: FloatArray) -> None:
        """Move a thing by an offset (2,), until the next reset."""
        import sapien

        thing = self._things[name]
        pose = thing.pose
        thing.set_pose(sapien.Pose(pose.p + self._turn.inv().apply([*offset, 0.0]), pose.q))
