"""Meshes with no more triangles than an image shows, for the render profile `fast-2`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from robogauntlet.adapters.contract import FloatArray, SimulatorUnavailable

TRIANGLES = 2000
"""Meshes with more triangles are simplified, to no fewer."""
SHARE = 4
"""One in so many triangles stays of those that are larger than a cell."""
CELL = 5e-4
"""Edge of the cells in which all vertices become one (m). A pixel of 96 px images shows 2 mm or more."""
SAMPLE = 30_000
"""Triangles of the original mesh, at most twice as many, from which a simplified one may take its shading."""

Indices = NDArray[np.int64]


def simplified(vertices: FloatArray, triangles: Indices, normals: FloatArray) -> tuple[FloatArray, Indices, Indices]:
    """Return vertices, triangles and shading of a simplified mesh, whose bounding box is not larger.

    Vertices are first joined in the cells of a grid, which takes most of the triangles of meshes that are much finer
    (Rossignac and Borrel, 1993), then edges are collapsed by the quadric error (Garland and Heckbert, 1997).

    Args:
        vertices: Shape (n, 3), m.
        triangles: Shape (t, 3), indices of vertices.
        normals: Shape (t, 3, 3), at the corners of the triangles.

    Returns:
        Vertices (m, 3), triangles (u, 3), and for their corners (u, 3) the row in `normals.reshape(-1, 3)` of a near
        corner of the original mesh that faces alike.

    Raises:
        SimulatorUnavailable: The library that collapses edges is not installed.
    """
    try:
        from fast_simplification import simplify
    except ImportError as error:
        raise SimulatorUnavailable(f"{error}; install it: pip install fast-simplification") from error
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    cells = np.floor((vertices - low) / CELL).astype(np.int64) @ np.array([1, 2**20, 2**40])
    _, first, cell = np.unique(cells, return_index=True, return_inverse=True)
    joined = cell.reshape(-1)[triangles]
    joined = joined[(joined != np.roll(joined, 1, axis=1)).all(axis=1)].astype(np.int32)
    points = vertices[first].astype(np.float64)
    if len(joined) > TRIANGLES:
        points, joined = simplify(points, joined, target_count=max(TRIANGLES, len(joined) // SHARE))
    points = points.clip(low, high)
    sample = np.arange(0, len(triangles), max(1, len(triangles) // SAMPLE))
    _, near = cKDTree(_inside(vertices[triangles[sample]])).query(_inside(points[joined]), k=8)
    near = 3 * sample[near // 3] + near % 3
    a, b, c = np.moveaxis(points[joined], 1, 0)
    facing = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    best = np.einsum("kni,ki->kn", normals.reshape(-1, 3)[near], facing).argmax(axis=1)
    return points, joined, near[np.arange(len(near)), best].reshape(-1, 3)


def _inside(corners: FloatArray) -> FloatArray:
    """Return points (3 t, 3) near the corners (t, 3, 3) of triangles, inside them."""
    return (0.8 * corners + 0.2 * corners.mean(axis=1, keepdims=True)).reshape(-1, 3)
