"""Where the things of LIBERO's tasks are: the middle of what they are, not the point that their files count from."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.contract import FloatArray
from adapters.frames import wxyz_to_xyzw

CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


@dataclass(frozen=True)
class Thing:
    """A movable thing. The middle of its shape stays where it is in its body's frame."""

    body: Any
    """MuJoCo's, of the data."""
    middle: FloatArray
    """Shape (3,), m, in the body's frame: a bowl's own origin lies 2 mm below its foot."""

    @property
    def xmat(self) -> FloatArray:
        """Orientation in the world, (9,), as MuJoCo's bodies have it."""
        return np.asarray(self.body.xmat)

    @property
    def xpos(self) -> FloatArray:
        """Position of the middle in the world, (3,), m."""
        return np.asarray(self.body.xpos + self.xmat.reshape(3, 3) @ self.middle)


def thing_of(model: Any, data: Any, name: str) -> Thing:
    """A movable thing of LIBERO's, by its name."""
    body = model.body(f"{name}_main").id
    solid = (model.geom_bodyid == body) & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    points = np.concatenate([_corners(model, geom) for geom in np.flatnonzero(solid)])
    return Thing(data.body(body), (points.min(axis=0) + points.max(axis=0)) / 2.0)


def _corners(model: Any, geom: int) -> FloatArray:
    """The corners (8, 3) of the box round a shape, in its body's frame."""
    box = model.geom_aabb[geom]
    turn = Rotation.from_quat(wxyz_to_xyzw(model.geom_quat[geom]))
    return np.asarray(turn.apply(box[:3] + CORNERS * box[3:]) + model.geom_pos[geom])


def middles(states: FloatArray, start: int, middle: FloatArray) -> FloatArray:
    """Where a thing's middle is in stored joint positions, (n, 3), m, world.

    Args:
        states: Joint positions, (n, nq).
        start: Where the thing's pose begins among them.
        middle: Of the thing, in its body's frame.
    """
    turns = Rotation.from_quat(np.roll(states[:, start + 3 : start + 7], -1, axis=1))
    return np.asarray(states[:, start : start + 3] + turns.apply(middle))
