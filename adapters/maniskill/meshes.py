"""Simplifies the meshes of ManiSkill's robots."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from robogauntlet.adapters.simplified_meshes import TRIANGLES, simplified


def simplify_links(robot: Any) -> None:
    """Replace what is drawn for the links of SAPIEN's articulation. Collisions and materials stay."""
    import sapien

    for link in robot.links:
        body = link.entity.find_component_by_type(sapien.render.RenderBodyComponent)
        if body is not None:
            link.entity.remove_component(body)
            link.entity.add_component(_simplified_body(body))


def _simplified_body(body: Any) -> Any:
    import sapien

    result = sapien.render.RenderBodyComponent()
    for shape in body.render_shapes:
        for number, part in enumerate(shape.parts):
            mesh = sapien.render.RenderShapeTriangleMesh(*_mesh(shape.filename, number), part.material)
            mesh.scale, mesh.local_pose = shape.scale, shape.local_pose
            result.attach(mesh)
    return result


@cache
def _mesh(filename: str, number: int) -> tuple[Any, ...]:
    """Return vertices (n, 3), triangles (m, 3), normals (n, 3) and texture coordinates (n, 2) of one part of a file."""
    import sapien

    part = sapien.render.RenderShapeTriangleMesh(filename).parts[number]
    normals, uvs = part.get_vertex_normal(), part.get_vertex_uv()
    if len(part.triangles) <= TRIANGLES:
        return part.vertices, part.triangles, normals, uvs
    rows = part.triangles
    vertices, triangles, shading = simplified(part.vertices, rows, normals[rows])
    # A vertex of SAPIEN has one normal.
    own, corners = np.unique(np.stack([triangles.ravel(), rows.ravel()[shading].ravel()]), axis=1, return_inverse=True)
    return vertices[own[0]], corners.reshape(-1, 3), normals[own[1]], uvs[own[1]]
