"""Paints the table of the PyBullet adapter and adds props, as bodies without a collision shape."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robogauntlet.adapters.contract import FloatArray, Image
from robogauntlet.adapters.pybullet.arm import BASE_IN_WORLD
from robogauntlet.adapters.scene_control import Form, Prop

COVER_HEIGHT = 0.0005
"""Height of the painted surface above the table (m); a texture on the table itself would wrap around its box."""
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
WHITE = (1.0, 1.0, 1.0, 1.0)
NO_COLLISION = -1


class PyBulletTable:
    """`TableControl` of `scene_control`."""

    def __init__(self, client: Any, table: int) -> None:
        """Take a physics server and its table, which is a box."""
        self._client = client
        size, self._centre = np.array(client.getVisualShapeData(table)[0][3]), np.array(_position(client, table))
        self._extent = size[:2]
        self._surface = float(self._centre[2] + size[2] / 2.0)
        self.table_height = self._surface - float(BASE_IN_WORLD[2])
        self.table_edges = self._centre[:2] - BASE_IN_WORLD[:2] + np.array([[-0.5], [0.5]]) * self._extent
        self._props: list[int] = []
        self._covers: list[int] = []
        self._textures: dict[tuple[int, bytes], int] = {}

    def undo(self) -> None:
        """Remove props and paint."""
        self._remove(self._covers)
        self._remove(self._props)

    def show(self, props: Sequence[Prop]) -> None:
        """Show these props instead of the previous ones, until the next reset."""
        self._remove(self._props)
        self._props += [self._create(prop) for prop in props]

    def shown(self) -> Sequence[FloatArray]:
        """Return the centres (3,) of the props (m)."""
        return [np.array(_position(self._client, prop)) - BASE_IN_WORLD for prop in self._props]

    def paint_table(self, texture: Image) -> None:
        """Cover the table with a texture until the next reset; from above, x is to its right and y is up."""
        self._remove(self._covers)
        corners = np.column_stack([(CORNERS - 0.5) * self._extent, np.zeros(4)])
        shape = self._client.createVisualShape(
            self._client.GEOM_MESH,
            vertices=corners.tolist(),
            indices=[0, 1, 2, 0, 2, 3],
            uvs=CORNERS.tolist(),
            normals=[[0.0, 0.0, 1.0]] * 4,
            rgbaColor=WHITE,
        )
        cover = self._body(shape, np.array([*self._centre[:2], self._surface + COVER_HEIGHT]))
        self._covers.append(cover)
        self._client.changeVisualShape(cover, -1, textureUniqueId=self._texture(texture))

    def _create(self, prop: Prop) -> int:
        client, half = self._client, prop.size / 2.0
        forms: dict[Form, tuple[int, dict[str, Any]]] = {
            Form.BOX: (client.GEOM_BOX, {"halfExtents": [half] * 3}),
            Form.SPHERE: (client.GEOM_SPHERE, {"radius": half}),
            Form.CYLINDER: (client.GEOM_CYLINDER, {"radius": half, "length": prop.size}),
        }
        geometry, sizes = forms[prop.form]
        shape = client.createVisualShape(geometry, rgbaColor=[*prop.colour, 1.0], **sizes)
        return self._body(shape, prop.position + BASE_IN_WORLD, prop.yaw)

    def _body(self, shape: int, position: FloatArray, yaw: float = 0.0) -> int:
        """Create a body without collisions."""
        upright = [0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)]
        body: int = self._client.createMultiBody(0.0, NO_COLLISION, shape, position.tolist(), upright)
        return body

    def _remove(self, bodies: list[int]) -> None:
        while bodies:
            self._client.removeBody(bodies.pop())

    def _texture(self, texture: Image) -> int:
        """Return PyBullet's number of a texture, which it reads from a file once and keeps until it closes."""
        from PIL import Image as Pillow

        key = (texture.shape[1], texture.tobytes())
        if key not in self._textures:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "texture.png"
                Pillow.fromarray(texture).save(path)
                self._textures[key] = self._client.loadTexture(str(path))
        return self._textures[key]


def _position(client: Any, body: int) -> tuple[float, float, float]:
    position: tuple[float, float, float] = client.getBasePositionAndOrientation(body)[0]
    return position
