"""Reads how far a gripper in MuJoCo is open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from robogauntlet.adapters.contract import AdapterError, FloatArray
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics


class Fingers(Protocol):
    """The two sides of a gripper."""

    def positions(self) -> FloatArray:
        """Return the distances of the fingers from where they meet, shape (2,) (m)."""

    def opening(self) -> float:
        """Return the distance between the fingers (m)."""


class SlidingFingers:
    """Fingers on slides, whose joint positions are the distances."""

    def __init__(self, physics: MujocoPhysics, joints: Sequence[str]) -> None:
        """Take the names of the two joints."""
        self._qpos = [physics.data.joint(name).qpos for name in joints]

    def positions(self) -> FloatArray:
        """Return the distances, shape (2,) (m)."""
        return np.abs([qpos[0] for qpos in self._qpos])

    def opening(self) -> float:
        """Return the distance between the fingers (m)."""
        return sum(abs(float(qpos[0])) for qpos in self._qpos)


class NoFingers:
    """What an arm has that holds a tool in place of a gripper."""

    def positions(self) -> FloatArray:
        """Return zeros, shape (2,) (m)."""
        return np.zeros(2)

    def opening(self) -> float:
        """Return 0 (m)."""
        return 0.0


class Pads:
    """Fingers of any other mechanism: half the gap between their pads, beyond that of the closed gripper."""

    def __init__(self, physics: MujocoPhysics, hand: str, pads: tuple[Sequence[str], Sequence[str]]) -> None:
        """Take the names of the hand's body, along whose y axis the fingers open, and of the pads' shapes, by side.

        Raises:
            AdapterError: The model has no such shape, so that the gripper's range cannot be measured.
        """
        self._hand = physics.data.body(hand)
        try:
            self._sides = [[physics.data.geom(name) for name in side] for side in pads]
        except KeyError as error:  # It goes on with the names of all shapes.
            wrong = str(error.args[0]).partition(". ")[0]
            raise AdapterError(f"expected shapes of the model as pads of the fingers, got others: {wrong}") from None
        self.closed = 0.0
        """Gap between the pads' centres when the gripper is closed and empty (m)."""

    def gap(self) -> float:
        """Return the distance between the pads' centres (m)."""
        left, right = (np.mean([pad.xpos for pad in side], axis=0) for side in self._sides)
        return abs(float((left - right) @ self._hand.xmat.reshape(3, 3)[:, 1]))

    def positions(self) -> FloatArray:
        """Return the distances, shape (2,) (m)."""
        return np.full(2, self.opening() / 2.0)

    def opening(self) -> float:
        """Return the distance between the fingers (m)."""
        return max(0.0, self.gap() - self.closed)
