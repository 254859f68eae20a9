"""Meshes for the render profile `fast-2`."""

import numpy as np
import pytest

from robogauntlet.adapters.simplified_meshes import RESOLUTION, TRIANGLES, simplified


def test_a_fine_sphere_stays_a_sphere_of_few_triangles():
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("fast_simplification")
    sphere = trimesh.creation.icosphere(subdivisions=6, radius=0.1)
    vertices, triangles = simplified(sphere.vertices, sphere.faces)
    assert len(sphere.faces) > 80_000
    assert len(triangles) <= 1.1 * TRIANGLES
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.1, atol=2 * RESOLUTION)
    assert trimesh.Trimesh(vertices, triangles).volume == pytest.approx(sphere.volume, rel=0.01)
