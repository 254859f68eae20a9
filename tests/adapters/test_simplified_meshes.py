"""Meshes for the render profile `fast-2`."""

import numpy as np
import pytest

from robogauntlet.adapters.simplified_meshes import CELL, SHARE, simplified


def test_a_fine_sphere_stays_a_smooth_sphere_of_fewer_triangles():
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("fast_simplification")
    sphere = trimesh.creation.icosphere(subdivisions=6, radius=0.1)
    normals = sphere.vertices[sphere.faces] / 0.1
    vertices, triangles, shading = simplified(sphere.vertices, sphere.faces, normals)
    assert len(sphere.faces) > 80_000
    assert len(triangles) <= len(sphere.faces) // SHARE
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.1, atol=2 * CELL)
    np.testing.assert_allclose(normals.reshape(-1, 3)[shading], vertices[triangles] / 0.1, atol=0.1)
    assert trimesh.Trimesh(vertices, triangles).volume == pytest.approx(sphere.volume, rel=0.01)


def test_the_edges_of_a_box_stay_sharp():
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("fast_simplification")
    box = trimesh.creation.box((0.2, 0.3, 0.4)).subdivide_to_size(0.01)
    normals = np.repeat(box.face_normals[:, None], 3, axis=1)
    vertices, triangles, shading = simplified(box.vertices, box.faces, normals)
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    flat = np.repeat(mesh.face_normals[:, None], 3, axis=1)
    large = mesh.area_faces > 1e-6
    np.testing.assert_allclose(normals.reshape(-1, 3)[shading][large], flat[large], atol=1e-2)
    np.testing.assert_allclose(mesh.bounds, box.bounds)
