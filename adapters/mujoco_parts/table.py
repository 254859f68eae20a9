"""Adds props to robosuite's tables, which are only rendered, and paints the tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray, Image
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.scene_control import Form, Prop

TABLE = "table_visual"
SPARE_MATERIAL, SPARE_TEXTURE = "table_mat", "textable"
"""robosuite's tables have a second material that is not used."""
TOP = 4
"""The upper face of MuJoCo's cube textures."""


class MujocoTable:
    """`TableControl` of `scene_control`. Props are added to the rendered scene, not to the model."""

    def __init__(self, physics: MujocoPhysics, renderers: Mapping[int, Any]) -> None:
        """Take the physics, with poses up to date, and the present renderers."""
        self._physics, self._renderers = physics, renderers
        self._mujoco, self._model = physics.mujoco, physics.model
        table = self._model.geom(TABLE)
        self._table, self._own_material = table.id, int(table.matid[0])
        top = physics.data.geom(TABLE).xpos + np.array([0.0, 0.0, table.size[2]])
        self.table_height = float(physics.from_world(top)[2])
        corners = [physics.from_world(top + sign * np.array([*table.size[:2], 0.0]))[:2] for sign in (-1.0, 1.0)]
        self.table_edges = np.sort(corners, axis=0)
        self._props: list[Any] = []

    def undo(self) -> None:
        """Remove the props and restore the table's surface."""
        self._props = []
        self._model.geom_matid[self._table] = self._own_material

    def show(self, props: Sequence[Prop]) -> None:
        """Show these props instead of the previous ones, until the next reset."""
        self._props = [self._shape(prop) for prop in props]

    def shown(self) -> Sequence[FloatArray]:
        """Return the centres of the props, from the shapes that MuJoCo renders."""
        return [self._physics.from_world(shape.pos.astype(np.float64)) for shape in self._props]

    def paint_table(self, texture: Image) -> None:
        """Paint the table with a texture (n, n, 3), until the next reset.

        In the frame of the world its first row has the smallest y, and its first column the smallest x. The edges take
        its mean colour.
        """
        spare = self._model.texture(SPARE_TEXTURE)
        size, start = int(spare.width[0]), int(spare.adr[0])
        faces = self._model.tex_data[start : start + 6 * size * size * 3].reshape(6, size, size, 3)
        nearest = np.arange(size) * len(texture) // size
        faces[:] = texture.reshape(-1, 3).mean(axis=0)
        faces[TOP] = texture[nearest[::-1]][:, nearest]
        material = self._model.material(SPARE_MATERIAL)
        material.specular[:], material.reflectance[:] = 0.0, 0.0
        self._model.geom_matid[self._table] = material.id
        for renderer in self._renderers.values():
            renderer._gl_context.make_current()
            self._mujoco.mjr_uploadTexture(self._model, renderer._mjr_context, spare.id)

    def draw(self, scene: Any) -> None:
        """Add the props to a scene before it is rendered."""
        for shape in self._props:
            drawn = scene.geoms[scene.ngeom]
            self._mujoco.mjv_initGeom(drawn, shape.type, shape.size, shape.pos, shape.mat.ravel(), shape.rgba)
            drawn.category = shape.category
            scene.ngeom += 1

    def _shape(self, prop: Prop) -> Any:
        """Return a prop as a shape of MuJoCo."""
        types = self._mujoco.mjtGeom
        form = {Form.BOX: types.mjGEOM_BOX, Form.SPHERE: types.mjGEOM_SPHERE, Form.CYLINDER: types.mjGEOM_CYLINDER}
        turned = self._physics.rotation * Rotation.from_euler("z", prop.yaw)
        shape = self._mujoco.MjvGeom()
        self._mujoco.mjv_initGeom(
            shape,
            form[prop.form],
            np.full(3, prop.size / 2.0),
            self._physics.to_world(prop.position),
            turned.as_matrix().ravel(),
            np.array([*prop.colour, 1.0], dtype=np.float32),
        )
        shape.category = self._mujoco.mjtCatBit.mjCAT_STATIC
        return shape
