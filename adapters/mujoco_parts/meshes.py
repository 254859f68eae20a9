"""Simplifies the meshes of robosuite's models."""

from __future__ import annotations

from typing import Any

import numpy as np

from robogauntlet.adapters.simplified_meshes import TRIANGLES, simplified


def simplify_meshes(mujoco: Any, model: Any) -> None:
    """Replace large meshes that are only drawn, in a compiled `MjModel` that has not been drawn yet.

    Physics does not read them: masses and inertias are those of the original meshes. Textured meshes stay.
    """
    shapes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    textured = (model.mat_texid[model.geom_matid] >= 0).any(axis=1) & (model.geom_matid >= 0)
    kept = set(model.geom_dataid[shapes[(collides | textured)[shapes]]])
    for mesh in set(model.geom_dataid[shapes]) - kept:
        if model.mesh_facenum[mesh] > TRIANGLES:
            _simplify(model, mesh)


def _simplify(model: Any, mesh: int) -> None:
    """Write a simplified mesh over the first rows of the original one. It uses the original normals."""
    vertex, normal, face = model.mesh_vertadr[mesh], model.mesh_normaladr[mesh], model.mesh_faceadr[mesh]
    faces = slice(face, face + model.mesh_facenum[mesh])
    rows = model.mesh_facenormal[faces].copy()
    vertices, triangles, shading = simplified(
        model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]],
        model.mesh_face[faces],
        model.mesh_normal[normal + rows],
    )
    count = model.mesh_facenum[mesh] = len(triangles)
    model.mesh_vert[vertex : vertex + len(vertices)] = vertices
    model.mesh_face[face : face + count] = triangles
    model.mesh_facenormal[face : face + count] = rows.reshape(-1)[shading]
