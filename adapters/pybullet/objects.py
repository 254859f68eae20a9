"""The things of panda-gym's tasks, which can be put elsewhere: the cube and the goal. A reset places both anew."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from adapters.adjusting import Placeable
from adapters.contract import FloatArray
from adapters.pybullet.frame import BASE_IN_WORLD

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class PyBulletObjects:
    """See `adapters.adjusting.Objects`. Moving one leaves the other where it is."""

    def __init__(self, env: Any) -> None:
        """Of an unwrapped panda-gym environment."""
        self._sim, self._task = env.sim, env.task

    def placeable(self) -> Mapping[str, Placeable]:
        """The cube, if there is one, and the goal, with the ranges that panda-gym draws them from."""
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


def _box(low: FloatArray, high: FloatArray) -> Placeable:
    """A range of panda-gym, in which things lie about the world's origin."""
    return Placeable((low - BASE_IN_WORLD)[:2], (high - BASE_IN_WORLD)[:2])
