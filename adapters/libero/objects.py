"""Puts the things of LIBERO's tasks elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from adapters.adjusting import Placeable
from adapters.contract import FloatArray
from adapters.libero.things import Thing, middles
from adapters.mujoco_parts.frame import BaseFrame

SLIP = 0.005
"""How far things move while they settle (m), in all but a few of the stored states."""


class LiberoObjects:
    """See `adapters.adjusting.Objects`. Every reset sets the whole state, so there is nothing else to undo."""

    def __init__(
        self,
        simulator: tuple[Any, Any],
        things: Mapping[str, Thing],
        states: FloatArray,
        frame: BaseFrame,
        settle: Callable[[], None],
    ) -> None:
        """Take what can be moved.

        Args:
            simulator: MuJoCo's model and data.
            things: Free things that stand on the ground, by name, the one that the task is about first.
            states: The stored states, shape (n, 1 + nq + nv).
            frame: The robot's base.
            settle: Brings forces and contacts up to date.
        """
        self._model, self._data = simulator
        self._frame, self._settle = frame, settle
        self._things = things
        self._stored = states[:, 1:]

    def placeable(self) -> Mapping[str, Placeable]:
        """What can be moved, within what the stored states fill."""
        return {name: self._box(thing) for name, thing in self._things.items()}

    def move(self, name: str, offset: FloatArray) -> None:
        """Move a thing by an offset (2,), x and y, until the next reset."""
        start = self._start(self._things[name])
        self._data.qpos[start : start + 3] += self._frame.rotation.apply([*offset, 0.0])
        self._settle()

    def _start(self, thing: Thing) -> int:
        """Where a thing's pose begins among the joint positions."""
        return int(self._model.jnt_qposadr[self._model.body_jntadr[thing.body.id]])

    def _box(self, thing: Thing) -> Placeable:
        centres = middles(self._stored, self._start(thing), thing.middle)
        points = np.array([self._frame.from_world(point) for point in centres])[:, :2]
        return Placeable(points.min(axis=0) - SLIP, points.max(axis=0) + SLIP)
