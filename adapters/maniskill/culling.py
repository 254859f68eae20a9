"""Leaves links of the robot that a camera cannot see out of ManiSkill's images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import product
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import FloatArray

MARGIN = 1e-3
"""Smallest distance of a hidden link from the view (m)."""


class ManiSkillCulling:
    """Hides links of the robot while an image is rendered.

    A link is hidden if its bounding box is beyond one of the six planes of the view. The `minimal` shader has neither
    shadows nor reflections, so no pixel depends on it. All other bodies together have fewer triangles than one link.
    """

    def __init__(self, robots: Iterable[Any]) -> None:
        """Take SAPIEN's articulations."""
        import sapien

        bodies = [
            link.entity.find_component_by_type(sapien.render.RenderBodyComponent)
            for robot in robots
            for link in robot.links
        ]
        self._bodies = [body for body in bodies if body]
        self._corners = [np.hstack([_corners(shape) for shape in body.render_shapes]) for body in self._bodies]

    @contextmanager
    def seen_by(self, camera: Any) -> Iterator[None]:
        """Hide the links that one of SAPIEN's cameras cannot see.

        Visibility is quick to change and keeps the order of drawing, unlike disabling a component.
        """
        view = camera.get_projection_matrix().astype(np.float64) @ np.linalg.inv(camera.get_model_matrix())
        hidden = [
            body for body, corners in zip(self._bodies, self._corners, strict=True) if _beyond(view, body, corners)
        ]
        for body in hidden:
            body.visibility = 0.0
        try:
            yield
        finally:
            for body in hidden:
                body.visibility = 1.0


def _beyond(view: FloatArray, body: Any, corners: FloatArray) -> bool:
    """Return whether all corners (4, n) of a body are beyond one plane of a view (4, 4), Vulkan's clip space."""
    x, y, z, w = view @ body.entity.pose.to_transformation_matrix() @ corners
    return any((distance > MARGIN).all() for distance in (x - w, -x - w, y - w, -y - w, z - w, -z))


def _corners(shape: Any) -> FloatArray:
    """Return the corners of a mesh's bounding box, homogeneous in the frame of its body, (4, 8)."""
    parts = [part.vertices for part in shape.parts]
    low, high = np.min([part.min(axis=0) for part in parts], 0), np.max([part.max(axis=0) for part in parts], 0)
    corners = [[*shape.scale * corner, 1.0] for corner in product(*zip(low, high, strict=True))]
    return shape.local_pose.to_transformation_matrix().astype(np.float64) @ np.transpose(corners)
