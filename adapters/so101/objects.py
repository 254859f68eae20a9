"""Places and moves the cubes and the target of the SO-101's tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.scene_control import PlacementRegion
from robogauntlet.adapters.so101.tasks import CUBE, Region

APART = 0.075
"""Least distance of two things at the start (m): the open jaws fit between them."""


class SO101Objects:
    """`Objects` of `scene_control`. Every reset places everything, so there is no `undo`."""

    def __init__(self, physics: MujocoPhysics, regions: Mapping[str, Region], cubes: Sequence[str]) -> None:
        """Take where resets put the cubes and the goal."""
        self._physics, self._model, self._data = physics, physics.model, physics.data
        self._regions, self._cubes = regions, cubes

    def place(self, generator: np.random.Generator) -> None:
        """Put everything at random, apart from each other: the first anywhere in its region, each after it likewise."""
        placed: list[FloatArray] = []
        for name, region in self._regions.items():
            while True:
                centre = generator.uniform(*region)
                if all(np.linalg.norm(centre - other) >= APART for other in placed):
                    break
            placed.append(centre)
            if name not in self._cubes:
                self._model.body(name).pos[:2] = centre
                continue
            half = generator.uniform(-np.pi / 4, np.pi / 4) / 2.0
            self._qpos(name)[:] = [*centre, CUBE / 2, np.cos(half), 0.0, 0.0, np.sin(half)]

    def placeable(self) -> Mapping[str, PlacementRegion]:
        """Return the regions of the cubes."""
        corners = {name: [np.array(corner) for corner in self._regions[name]] for name in self._cubes}
        return {name: PlacementRegion(low, high) for name, (low, high) in corners.items()}

    def move(self, name: str, offset: FloatArray) -> None:
        """Move a cube by an offset (2,), x and y, until the next reset."""
        self._qpos(name)[:3] += self._physics.rotation.apply([*offset, 0.0])
        self._physics.settle()

    def _qpos(self, name: str) -> FloatArray:
        start = int(self._model.jnt_qposadr[self._model.body(name).jntadr[0]])
        pose: FloatArray = self._data.qpos[start : start + 7]
        return pose
