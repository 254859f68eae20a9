"""Finds the shapes of a MuJoCo model that a camera cannot see, so that they need not be drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.contract import FloatArray

MARGIN = 1e-3
"""Share of its distance by which a shape must be outside the view: far more than MuJoCo's single precision rounds."""


class MujocoCulling:
    """Compares the bounding sphere and the bounding box of each shape of a model with a camera's view.

    Planes and height fields are never outside.
    """

    def __init__(self, mujoco: Any, model: Any) -> None:
        """Take MuJoCo's module and a model, whose shapes keep their sizes."""
        self._mujoco, self._model = mujoco, model
        types = mujoco.mjtGeom
        self._mirrors = np.isin(model.geom_type, (types.mjGEOM_PLANE, types.mjGEOM_BOX))
        self._bounded = np.isin(model.geom_type, (types.mjGEOM_PLANE, types.mjGEOM_HFIELD), invert=True)
        self._radius = model.geom_rbound[:, None]
        self._centre, self._half = model.geom_aabb[:, None, :3], model.geom_aabb[:, None, 3:]

    def outside(self, data: Any, scene: Any) -> NDArray[np.bool_]:
        """Return which shapes (n,) can be left out without changing a pixel of a square image.

        None where a shadow or a mirror could show what is outside the view. `scene` has the camera.
        """
        model, flags, drawn = self._model, scene.flags, self._mujoco.mjtRndFlag
        mirrors = self._mirrors & (model.geom_matid >= 0)
        mirrors[mirrors] = model.mat_reflectance[model.geom_matid[mirrors]] > 0.0
        shadows = model.light_castshadow & model.light_active
        if (flags[drawn.mjRND_SHADOW] and shadows.any()) or (flags[drawn.mjRND_REFLECTION] and mirrors.any()):
            return np.zeros(model.ngeom, dtype=np.bool_)
        eye, inward, least = view_planes(self._mujoco.mjv_averageCamera(*scene.camera))
        lengths, away = np.linalg.norm(inward, axis=1), data.geom_xpos - eye
        # The normals in the frame of each shape, (n, planes, 3).
        turned = inward @ data.geom_xmat.reshape(-1, 3, 3)
        box = (turned * self._centre + np.abs(turned) * self._half).sum(axis=2)
        reach = np.minimum(box, self._radius * lengths)
        slack = MARGIN * lengths * (np.linalg.norm(away, axis=1, keepdims=True) + self._radius)
        hidden = (away @ inward.T + reach + slack < least).any(axis=1)
        # Also without reflections, MuJoCo draws the first shape that mirrors before all others: it must stay the first.
        result: NDArray[np.bool_] = hidden & self._bounded & ~mirrors
        return result


def view_planes(camera: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what a camera (`MjvGLCamera`) may see in a square image: the points p with inward @ (p - eye) >= least.

    An orthographic camera sees less, as its rays are parallel from the near plane on.

    Returns:
        The position of the eye (3,), m, and left, right, lower, upper and near plane: inward normals (5, 3), of any
        length, and distances times that length (5,).
    """
    forward, up = np.array(camera.forward, dtype=np.float64), np.array(camera.up, dtype=np.float64)
    low, high, near = camera.frustum_bottom, camera.frustum_top, camera.frustum_near
    half = camera.frustum_width or (high - low) / 2.0
    left, right = camera.frustum_center - half, camera.frustum_center + half
    normals = [(near, 0, -left), (-near, 0, right), (0, near, -low), (0, -near, high), (0, 0, 1)]
    (a, b, c), (d, e, f) = forward, up
    axes = np.array([(b * f - c * e, c * d - a * f, a * e - b * d), up, forward])
    return np.array(camera.pos, dtype=np.float64), np.array(normals) @ axes, np.array([0.0, 0.0, 0.0, 0.0, near])
