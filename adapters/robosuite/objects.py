"""Puts the things of robosuite's tasks elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.adjusting import Placeable
from adapters.contract import FloatArray
from adapters.frames import wxyz_to_xyzw
from adapters.mujoco_parts.frame import BaseFrame


class RobosuiteObjects:
    """See `adapters.adjusting.Objects`. Every reset places all things anew, so there is nothing else to undo."""

    def __init__(
        self,
        simulator: tuple[Any, Any],
        things: Mapping[str, str],
        sampler: Any,
        frame: BaseFrame,
        settle: Callable[[], None],
    ) -> None:
        """Take what can be moved.

        Args:
            simulator: MuJoCo's model and data.
            things: Names to bodies, the thing that the task is about first.
            sampler: robosuite's, which places the things in resets.
            frame: The robot's base.
            settle: Brings forces and contacts up to date.
        """
        self._model, self._data = simulator
        self._sampler, self._frame, self._settle = sampler, frame, settle
        self._bodies = {name: self._model.body(body).id for name, body in things.items()}

    def placeable(self) -> Mapping[str, Placeable]:
        """What can be moved, within what robosuite's sampler fills."""
        return {name: self._box(body) for name, body in self._bodies.items()}

    def move(self, name: str, offset: FloatArray) -> None:
        """Move a thing by an offset (2,), x and y, until the next reset."""
        root = self._model.body_rootid[self._bodies[name]]
        shift = self._frame.rotation.apply([*offset, 0.0])
        if self._model.body_dofnum[root] == 6:
            start = self._model.jnt_qposadr[self._model.body_jntadr[root]]
            self._data.qpos[start : start + 3] += shift
        else:
            self._model.body_pos[root] += shift
        self._settle()

    def _box(self, body: int) -> Placeable:
        """Where resets put the centre of a body. They place its root, which the door is mounted beside, and turn it."""
        lever, sampler = self._lever(body), self._sampler
        start, end = sampler.rotation or (0.0, 2.0 * np.pi)
        turns = np.linspace(start, end, 1001)[:, None] * [0.0, 0.0, 1.0]
        sweep = Rotation.from_rotvec(turns).apply(lever)
        ranges = np.array([sampler.x_range, sampler.y_range, (0.0, 0.0)])
        low = ranges[:, 0] + sampler.reference_pos + sweep.min(axis=0)
        high = ranges[:, 1] + sampler.reference_pos + sweep.max(axis=0)
        return Placeable(self._frame.from_world(low)[:2], self._frame.from_world(high)[:2])

    def _lever(self, body: int) -> FloatArray:
        """Where a body is in the frame of its root, joints at rest."""
        point, root = np.zeros(3), self._model.body_rootid[body]
        while body != root:
            turn = Rotation.from_quat(wxyz_to_xyzw(self._model.body_quat[body]))
            point = turn.apply(point) + self._model.body_pos[body]
            body = self._model.body_parentid[body]
        return point
