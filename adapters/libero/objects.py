"""Where the objects of LIBERO's tasks are, by the centre of their shape, and how they are moved."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.scene_control import PlacementRegion

CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
SLIP = 0.005
"""Largest distance that objects move while they settle (m), except in a few stored states."""


@dataclass(frozen=True)
class LiberoObject:
    """A movable object. The centre of its shape is fixed in its body's frame."""

    body: Any
    """A body of MuJoCo's data."""
    centre: FloatArray
    """Shape (3,), m, in the body's frame: the origin of a bowl, for example, is 2 mm below its foot."""

    @property
    def xmat(self) -> FloatArray:
        """Orientation in the world, (9,), as MuJoCo's bodies have it."""
        return np.asarray(self.body.xmat)

    @property
    def xpos(self) -> FloatArray:
        """Position of the centre in the world, (3,), m."""
        return np.asarray(self.body.xpos + self.xmat.reshape(3, 3) @ self.centre)


def libero_object(model: Any, data: Any, name: str) -> LiberoObject:
    """Return a movable object by its name."""
    body = model.body(f"{name}_main").id
    fixed = model.body_weldid[model.geom_bodyid] == body  # One object has its shapes in a body that is fixed to it.
    solid = fixed & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    points = np.concatenate([_corners(model, geom, body) for geom in np.flatnonzero(solid)])
    return LiberoObject(data.body(body), (points.min(axis=0) + points.max(axis=0)) / 2.0)


def _corners(model: Any, geom: int, body: int) -> FloatArray:
    """Return the corners (8, 3) of a shape's bounding box, in the frame of a body to which it is fixed."""
    box = model.geom_aabb[geom]
    points = _moved(box[:3] + CORNERS * box[3:], model.geom_pos[geom], model.geom_quat[geom])
    carrier = model.geom_bodyid[geom]
    while carrier != body:
        points = _moved(points, model.body_pos[carrier], model.body_quat[carrier])
        carrier = model.body_parentid[carrier]
    return points


def _moved(points: FloatArray, position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Return points (n, 3) of a frame, by its position and quaternion wxyz, in the frame around it."""
    return np.asarray(Rotation.from_quat(wxyz_to_xyzw(quaternion)).apply(points) + position)


class LiberoObjects:
    """`Objects` of `scene_control`. Every reset sets the whole state, so there is no `undo`."""

    def __init__(self, physics: MujocoPhysics, objects: Mapping[str, LiberoObject], states: FloatArray) -> None:
        """Take the movable objects that stand on the ground, by name, the main object of the task first.

        `states` are the stored states, shape (n, 1 + nq + nv).
        """
        self._physics, self._model, self._data = physics, physics.model, physics.data
        self._objects = objects
        self._stored = states[:, 1:]

    def placeable(self) -> Mapping[str, PlacementRegion]:
        """Return the regions that the stored states fill."""
        return {name: self._box(movable) for name, movable in self._objects.items()}

    def move(self, name: str, offset: FloatArray) -> None:
        """Move an object by an offset (2,), x and y, until the next reset."""
        start = self._start(self._objects[name])
        self._data.qpos[start : start + 3] += self._physics.rotation.apply([*offset, 0.0])
        self._physics.settle()

    def _start(self, movable: LiberoObject) -> int:
        """Return the index of an object's pose among the joint positions."""
        return int(self._model.jnt_qposadr[self._model.body_jntadr[movable.body.id]])

    def _box(self, movable: LiberoObject) -> PlacementRegion:
        poses = self._stored[:, self._start(movable) :][:, :7]
        turns = Rotation.from_quat(np.roll(poses[:, 3:], -1, axis=1))
        centres = poses[:, :3] + turns.apply(movable.centre)
        points = np.array([self._physics.from_world(point) for point in centres])[:, :2]
        return PlacementRegion(points.min(axis=0) - SLIP, points.max(axis=0) + SLIP)
