"""Leaves links of the arm that a camera cannot see out of images, whose triangles are nearly all the arm's."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray

MARGIN = 0.02
"""Width by which a link's box is enlarged (m). TinyRenderer draws poses that are 2 ms newer than those that can be read
without changing the physics; in this time, a link would have to move at 10 m/s to leave the margin."""
INVISIBLE = 0.0
"""Alpha of links that TinyRenderer does not draw. They still cast shadows."""


class PyBulletCulling:
    """Compares the bounding box of each link's mesh with a camera's view."""

    def __init__(self, client: Any, body: int) -> None:
        """Take a physics server and an arm whose links have meshes in Wavefront files."""
        self._client, self._body = client, body
        shapes = [shape for shape in client.getVisualShapeData(body) if shape[1] >= 0]
        self._colours = {shape[1]: shape[7] for shape in shapes}
        self._links = [shape[1] for shape in shapes]
        self._centre, self._half = np.stack([_box(shape) for shape in shapes], axis=1)[:, :, None]
        self._left_out: frozenset[int] = frozenset()

    def outside(self, view: Sequence[float], projection: Sequence[float]) -> frozenset[int]:
        """Return the links that images with these matrices, of 16 numbers in OpenGL's order, do not show."""
        x, y, _, w = np.reshape(projection, (4, 4)).T @ np.reshape(view, (4, 4)).T
        planes = np.stack([w + x, w - x, w + y, w - y, w])
        states = self._client.getLinkStates(self._body, self._links)
        positions, turns = (np.array([state[i] for state in states]) for i in (4, 5))
        # Normals of the planes in the frame of each link, (n, planes, 3), and how far its box reaches into the view.
        turned = planes[:, :3] @ Rotation.from_quat(turns).as_matrix()
        reach = (turned * self._centre + np.abs(turned) * self._half).sum(axis=2)
        hidden = (reach + positions @ planes[:, :3].T + planes[:, 3] < 0.0).any(axis=1)
        return frozenset(link for link, left_out in zip(self._links, hidden.tolist(), strict=True) if left_out)

    def leave_out(self, links: Collection[int]) -> None:
        """Draw all links except these, until the next call."""
        for link in self._left_out.symmetric_difference(links):
            *colour, alpha = self._colours[link]
            self._client.changeVisualShape(self._body, link, rgbaColor=[*colour, INVISIBLE if link in links else alpha])
        self._left_out = frozenset(links)


def _box(shape: Sequence[Any]) -> tuple[FloatArray, FloatArray]:
    """Return centre (3,) and half the lengths (3,) of a visual shape's enlarged box in the frame of its link (m)."""
    _, _, _, scale, file, position, quaternion, *_ = shape
    vertices = Rotation.from_quat(quaternion).apply(_vertices(file) * scale) + position
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return (low + high) / 2.0, (high - low) / 2.0 + MARGIN


@cache
def _vertices(file: bytes) -> FloatArray:
    with Path(file.decode()).open(encoding="utf-8") as lines:
        return np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=np.float64)
