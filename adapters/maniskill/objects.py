"""Moves the objects of ManiSkill's tasks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.maniskill.tasks import Region
from robogauntlet.adapters.scene_control import PlacementRegion


class ManiSkillObjects:
    """`Objects` of `scene_control`. Goals and fixtures stay where they are."""

    def __init__(self, objects: Mapping[str, Any], regions: Mapping[str, Region], base_from_world: Any) -> None:
        """Take SAPIEN's entities by name, where resets put them, and the pose of the world in the base frame."""
        self._objects = objects
        self._turn = Rotation.from_quat(wxyz_to_xyzw(base_from_world.q))
        self._boxes = {name: self._box(regions[name], base_from_world) for name in objects}

    def placeable(self) -> Mapping[str, PlacementRegion]:
        """Return the region of each object."""
        return self._boxes

    def _box(self, region: Region, base_from_world: Any) -> PlacementRegion:
        corners = self._turn.apply([[*corner, 0.0] for corner in region]) + base_from_world.p
        return PlacementRegion(corners[:, :2].min(axis=0), corners[:, :2].max(axis=0))

    def move(self, name: str, offset: FloatArray) -> None:
        """Move an object by an offset (2,), until the next reset."""
        import sapien

        pose = self._objects[name].pose
        self._objects[name].set_pose(sapien.Pose(pose.p + self._turn.inv().apply([*offset, 0.0]), pose.q))
