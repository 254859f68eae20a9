"""Meshes with no more triangles than an image shows, for the render profile `fast-2`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.contract import FloatArray, SimulatorUnavailable

TRIANGLES = 2000
"""About the largest number of triangles of a simplified mesh."""
RESOLUTION = 5e-4
"""Edge of the cells in which all vertices become one (m). A pixel of 96 px images shows 2 mm or more."""

Triangles = NDArray[np.int32]


def simplified(vertices: FloatArray, triangles: Triangles) -> tuple[FloatArray, Triangles]:
    """Return vertices (n, 3), in m, and triangles (m, 3), indices of vertices, of a simplified mesh.

    Vertices are first joined in the cells of a grid, which takes most of the triangles of meshes that are much finer
    (Rossignac and Borrel, 1993), then edges are collapsed by the quadric error (Garland and Heckbert, 1997).

    Raises:
        SimulatorUnavailable: The library that collapses edges is not installed.
    """
    try:
        from fast_simplification import simplify
    except ImportError as error:
        raise SimulatorUnavailable(f"{error}; install it: pip install fast-simplification") from error
    cells = np.floor((vertices - vertices.min(axis=0)) / RESOLUTION).astype(np.int64) @ np.array([1, 2**20, 2**40])
    _, first, cell = np.unique(cells, return_index=True, return_inverse=True)
    joined = cell.reshape(-1)[triangles]
    joined = joined[(joined != np.roll(joined, 1, axis=1)).all(axis=1)].astype(np.int32)
    if len(joined) <= TRIANGLES:
        return vertices[first], joined
    points, faces = simplify(vertices[first], joined, target_count=TRIANGLES)
    return points, faces
