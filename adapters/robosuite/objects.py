"""Moves the objects of robosuite's tasks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.scene_control import PlacementRegion


class RobosuiteObjects:
    """`Objects` of `scene_control`. Every reset places all objects, so there is no `undo`."""

    def __init__(
        self, physics: MujocoPhysics, objects: Mapping[str, str], attached: Mapping[str, tuple[str, ...]], sampler: Any
    ) -> None:
        """Take the objects' bodies by name, the main object of the task first, and robosuite's placement initializer.

        `attached` has the names of the bodies that are mounted on each object.
        """
        self._physics, self._model, self._data = physics, physics.model, physics.data
        self._attached, self._sampler = attached, sampler
        self._bodies = {name: self._model.body(body).id for name, body in objects.items()}

    def placeable(self) -> Mapping[str, PlacementRegion]:
        """Return the regions that robosuite's sampler fills."""
        return {name: self._box(name) for name in self._bodies}

    def move(self, name: str, offset: FloatArray) -> None:
        """Move an object by an offset (2,), x and y, until the next reset."""
        root = self._model.body_rootid[self._bodies[name]]
        shift = self._physics.rotation.apply([*offset, 0.0])
        if self._model.body_dofnum[root] == 6:
            start = self._model.jnt_qposadr[self._model.body_jntadr[root]]
            self._data.qpos[start : start + 3] += shift
        else:
            self._model.body_pos[root] += shift
        self._physics.settle()

    def _box(self, name: str) -> PlacementRegion:
        """Return the region of an object's centre. Resets place and rotate its root; the door is mounted beside it."""
        lever, sampler = self._lever(self._bodies[name]), self._sampler
        start, end = sampler.rotation or (0.0, 2.0 * np.pi)
        turns = np.linspace(start, end, 1001)[:, None] * [0.0, 0.0, 1.0]
        sweep = Rotation.from_rotvec(turns).apply(lever)
        ranges = np.array([sampler.x_range, sampler.y_range, (0.0, 0.0)])
        low = ranges[:, 0] + sampler.reference_pos + sweep.min(axis=0)
        high = ranges[:, 1] + sampler.reference_pos + sweep.max(axis=0)
        corners = self._physics.from_world(low)[:2], self._physics.from_world(high)[:2]
        return PlacementRegion(*corners, attached=self._attached[name])

    def _lever(self, body: int) -> FloatArray:
        """Return the position of a body in the frame of its root, joints at rest."""
        point, root = np.zeros(3), self._model.body_rootid[body]
        while body != root:
            turn = Rotation.from_quat(wxyz_to_xyzw(self._model.body_quat[body]))
            point = turn.apply(point) + self._model.body_pos[body]
            body = self._model.body_parentid[body]
        return point
