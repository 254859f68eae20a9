"""Moves the cube and the goal of panda-gym's tasks. Every reset places both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.pybullet.arm import BASE_IN_WORLD
from robogauntlet.adapters.scene_control import PlacementRegion

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class PyBulletObjects:
    """`Objects` of `scene_control`. Each is moved independently of the other."""

    def __init__(self, env: Any) -> None:
        """Take an unwrapped panda-gym environment."""
        self._sim, self._task = env.sim, env.task

    def placeable(self) -> Mapping[str, PlacementRegion]:
        """Return the regions of the cube, if the task has one, and of the goal, as panda-gym samples them."""
        task = self._task
        goal = _box(task.goal_range_low, task.goal_range_high)
        if "object" not in self._sim._bodies_idx:
            return {"goal": goal}
        return {"cube": _box(task.obj_range_low, task.obj_range_high), "goal": goal}

    def move(self, name: str, offset: FloatArray) -> None:
        """Move the cube or the goal by an offset (2,), until the next reset."""
        shift = np.append(offset, 0.0)
        if name == "goal":
            self._task.goal = self._task.goal + shift
            self._sim.set_base_pose("target", self._task.goal, UPRIGHT)
        else:
            client, body = self._sim.physics_client, self._sim._bodies_idx["object"]
            position, quaternion = client.getBasePositionAndOrientation(body)
            self._sim.set_base_pose("object", position + shift, quaternion)


def _box(low: FloatArray, high: FloatArray) -> PlacementRegion:
    """Convert a range of panda-gym's world to the base frame."""
    return PlacementRegion((low - BASE_IN_WORLD)[:2], (high - BASE_IN_WORLD)[:2])
