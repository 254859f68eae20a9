"""Copies of the meshes of panda-gym's arm that TinyRenderer draws identically each time, simplified if wanted."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from itertools import product
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from robogauntlet.adapters.contract import AdapterError, FloatArray
from robogauntlet.adapters.simplified_meshes import TRIANGLES, simplified

ARM = "franka_panda"
"""Folder of the arm in PyBullet's data."""
MOST_STEPS = 3
"""Steps in single precision by which a component of a normal is moved at most, to settle it."""


@contextmanager
def arm_to_draw(*, simplify: bool) -> Iterator[None]:
    """Make panda-gym load an arm whose normals are settled, with fewer triangles if `simplify`.

    Physics reads the original shapes.
    """
    import pybullet_data

    original, folder = Path(pybullet_data.getDataPath()) / ARM, _folder(simplify, os.getpid())
    arm = folder / ARM
    folder.mkdir(mode=0o700)
    try:
        shutil.copytree(original, arm)
        # Links without a visual mesh are drawn as their collision mesh.
        for file in original.glob("meshes/*/*.obj"):
            visual = file.parent.name == "visual"
            (arm / file.relative_to(original)).write_text(_to_draw(file, simplify and visual), encoding="utf-8")
        with patch("pybullet_data.getDataPath", return_value=str(folder)):
            yield
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@cache
def _folder(simplify: bool, process: int) -> Path:
    """Return the place of a folder for all openings with these arguments.

    PyBullet keeps what it has read under the name of the file, and forked processes must not share the folder.
    """
    with tempfile.TemporaryDirectory(prefix="robogauntlet-") as folder:
        return Path(folder)


@cache
def _to_draw(file: Path, simplify: bool) -> str:
    """Return a Wavefront file with settled normals, simplified or not."""
    lines = (_simplified(file) if simplify else file.read_text(encoding="utf-8")).splitlines()
    places = [place for place, line in enumerate(lines) if line.startswith("vn ")]
    for place, normal in zip(places, settled(_numbers([lines[place] for place in places])).tolist(), strict=True):
        lines[place] = "vn {:.9g} {:.9g} {:.9g}".format(*normal)
    return "\n".join(lines) + "\n"


def settled(normals: FloatArray) -> NDArray[np.float32]:
    """Return unit vectors (n, 3) next to these that TinyRenderer's normalisation leaves as they are.

    TinyRenderer normalises a vertex's normal whenever it draws the vertex, and keeps the result
    (bullet3, examples/TinyRenderer/model.cpp, `Model::normal`). In single precision many normals never settle but
    alternate between two values, so that an image depends on how many were drawn before.
    """
    units = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    moves = product(range(-MOST_STEPS, MOST_STEPS + 1), repeat=3)
    for move in sorted(moves, key=lambda steps: np.abs(steps).sum()):
        left = np.flatnonzero(_length(units) != 1.0)
        moved = (units[left].view(np.int32) + np.array(move, dtype=np.int32)).view(np.float32)
        found = _length(moved) == 1.0
        units[left[found]] = moved[found]
    if (_length(units) != 1.0).any():
        raise AdapterError("PyBullet's arm has normals that cannot be settled")
    return units


def _length(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the lengths (n,) of vectors (n, 3), with TinyRenderer's roundings."""
    x, y, z = np.square(vectors).T
    return np.sqrt((x + y) + z)


def _simplified(file: Path) -> str:
    """Return a Wavefront file of triangles with fewer of them in each group that has a material."""
    head, *groups = file.read_text(encoding="utf-8").split("usemtl ")
    lines = [line for part in (head, *groups) for line in part.splitlines()]
    text = [line for line in lines if line.startswith(("mtllib ", "v"))]
    vertices, normals = (_numbers([line for line in text if line.startswith(kind)]) for kind in ("v ", "vn "))
    count = len(vertices)
    for group in groups:
        material, *lines = group.splitlines()
        faces = [line for line in lines if line.startswith("f ")]
        if len(faces) > TRIANGLES:
            # Rows of corners: vertex, point of the texture (0 for none) and normal, counted from 1.
            corners = _numbers([face.replace("//", "/0/").replace("/", " ") for face in faces]).astype(np.int64)
            used, own = np.unique(corners[:, 0], return_inverse=True)
            shaded = normals[corners[:, 2] - 1].reshape(-1, 3, 3)
            points, triangles, shading = simplified(vertices[used - 1], own.reshape(-1, 3), shaded)
            drawn = corners[shading]
            drawn[..., 0] = triangles + count + 1
            # One colour, as the corners of a triangle may lie in distant parts of the texture.
            drawn[..., 1] = drawn[:, :1, 1]
            text += ["v {:.6f} {:.6f} {:.6f}".format(*point) for point in points.tolist()]
            rows = ["f {}/{}/{} {}/{}/{} {}/{}/{}".format(*row) for row in drawn.reshape(-1, 9).tolist()]
            faces = [row.replace("/0/", "//") for row in rows]
            count += len(points)
        # PyBullet gives all triangles of an object the material that it names last.
        text += [f"o {material}", f"usemtl {material}", *faces]
    return "\n".join(text) + "\n"


def _numbers(lines: list[str]) -> FloatArray:
    """Return what follows the first word of each line, in rows of three."""
    return np.fromstring(" ".join(line.partition(" ")[2] for line in lines), sep=" ").reshape(-1, 3)
