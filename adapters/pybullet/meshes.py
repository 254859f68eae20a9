"""Simplifies the meshes of panda-gym's arm."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from unittest.mock import patch

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.adapters.simplified_meshes import TRIANGLES, simplified

ARM = "franka_panda"
"""Folder of the arm in PyBullet's data."""


@contextmanager
def simplified_arm() -> Iterator[None]:
    """Make panda-gym load an arm that is drawn with fewer triangles. What physics reads are copies of the originals."""
    import pybullet_data

    original, folder = Path(pybullet_data.getDataPath()) / ARM, _folder()
    arm = folder / ARM
    try:
        folder.mkdir(mode=0o700)
        shutil.copytree(original, arm)
        for file in original.glob("meshes/visual/*.obj"):
            (arm / file.relative_to(original)).write_text(_simplified(file), encoding="utf-8")
        with patch("pybullet_data.getDataPath", return_value=str(folder)):
            yield
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@cache
def _folder() -> Path:
    """Return the place of a folder for all openings, as PyBullet keeps what it has read under the name of the file."""
    with tempfile.TemporaryDirectory(prefix="robogauntlet-") as folder:
        return Path(folder)


@cache
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
