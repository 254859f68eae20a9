"""Simplifies the meshes of MuJoCo's models."""

from __future__ import annotations

from typing import Any

import numpy as np

from robogauntlet.adapters.simplified_meshes import TRIANGLES, simplified

FINE = 3e-3
"""A textured mesh is simplified if the edge of its mean triangle is at most this (m).

At 4 mm, as in LIBERO's plates, the texture was visibly displaced.
"""


def simplify_meshes(mujoco: Any, model: Any, *, textured: bool = False) -> None:
    """Replace large meshes that are only drawn, in a compiled `MjModel` that has not been drawn yet.

    Physics does not read them: masses and inertias are those of the original meshes.

    Args:
        mujoco: The module.
        model: The model, which is changed.
        textured: Whether textured meshes of triangles no larger than `FINE` are replaced too. Their texture moves by up
            to such a triangle.
    """
    shapes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    has_texture = (model.mat_texid[model.geom_matid] >= 0).any(axis=1) & (model.geom_matid >= 0)
    with_texture = set(model.geom_dataid[shapes[has_texture[shapes]]])
    for mesh in set(model.geom_dataid[shapes]) - set(model.geom_dataid[shapes[collides[shapes]]]):
        if model.mesh_facenum[mesh] > TRIANGLES and (mesh not in with_texture or (textured and _is_fine(model, mesh))):
            _simplify(model, mesh)


def _is_fine(model: Any, mesh: int) -> bool:
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    a, b, c = np.moveaxis(model.mesh_vert[model.mesh_vertadr[mesh] + model.mesh_face[faces]], 1, 0)
    return bool(np.linalg.norm(np.cross(b - a, c - a), axis=1).mean() <= FINE**2)


def _simplify(model: Any, mesh: int) -> None:
    """Write a simplified mesh over the first rows of the original one. It uses the original normals and texture."""
    vertex, normal, face = model.mesh_vertadr[mesh], model.mesh_normaladr[mesh], model.mesh_faceadr[mesh]
    faces = slice(face, face + model.mesh_facenum[mesh])
    rows, texture = model.mesh_facenormal[faces].copy(), model.mesh_facetexcoord[faces].copy()
    vertices, triangles, shading = simplified(
        model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]],
        model.mesh_face[faces],
        model.mesh_normal[normal + rows],
    )
    count = model.mesh_facenum[mesh] = len(triangles)
    model.mesh_vert[vertex : vertex + len(vertices)] = vertices
    model.mesh_face[face : face + count] = triangles
    model.mesh_facenormal[face : face + count] = rows.reshape(-1)[shading]
    model.mesh_facetexcoord[face : face + count] = texture.reshape(-1)[shading]
