"""Sets the stage of robosuite's tables: props that are only drawn, and another surface on the table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from adapters.adjusting import Form, Prop
from adapters.contract import FloatArray, Image
from adapters.mujoco_parts.frame import BaseFrame

TABLE = "table_visual"
SPARE_MATERIAL, SPARE_TEXTURE = "table_mat", "textable"
"""robosuite's tables come with a second material that nothing wears."""
TOP = 4
"""The face of MuJoCo's cube textures that lies upwards."""


class MujocoStage:
    """See `adapters.adjusting.Stage`. Props are added to what is drawn, not to the model."""

    def __init__(self, mujoco: Any, simulator: tuple[Any, Any], frame: BaseFrame, renderers: Mapping[int, Any]) -> None:
        """Take the table.

        Args:
            mujoco: The module.
            simulator: MuJoCo's model and data, with poses up to date.
            frame: The robot's base.
            renderers: Those that exist, whenever asked.
        """
        self._mujoco, self._frame, self._renderers = mujoco, frame, renderers
        self._model, data = simulator
        table = self._model.geom(TABLE)
        self._table, self._own_material = table.id, int(table.matid[0])
        top = data.geom(TABLE).xpos + np.array([0.0, 0.0, table.size[2]])
        self.table_height = float(frame.from_world(top)[2])
        self._props: list[Any] = []

    def undo(self) -> None:
        """Take the props away and give the table its own surface back."""
        self._props = []
        self._model.geom_matid[self._table] = self._own_material

    def show(self, props: Sequence[Prop]) -> None:
        """Draw props, in place of those before, until the next reset."""
        self._props = [self._shape(prop) for prop in props]

    def shown(self) -> Sequence[FloatArray]:
        """Centres of the props, from the shapes that MuJoCo draws."""
        return [self._frame.from_world(shape.pos.astype(np.float64)) for shape in self._props]

    def paint_table(self, texture: Image) -> None:
        """Draw the table with a texture (n, n, 3), until the next reset.

        Seen by the robot, its first row is the farthest and its first column the leftmost. The table's edges take its
        mean colour.
        """
        found = self._model.texture(SPARE_TEXTURE)
        size, start = int(found.width[0]), int(found.adr[0])
        faces = self._model.tex_data[start : start + 6 * size * size * 3].reshape(6, size, size, 3)
        nearest = np.arange(size) * len(texture) // size
        faces[:] = texture.reshape(-1, 3).mean(axis=0)
        faces[TOP] = texture[nearest[::-1]][:, nearest]
        material = self._model.material(SPARE_MATERIAL)
        material.specular[:], material.reflectance[:] = 0.0, 0.0
        self._model.geom_matid[self._table] = material.id
        for renderer in self._renderers.values():
            renderer._gl_context.make_current()
            self._mujoco.mjr_uploadTexture(self._model, renderer._mjr_context, found.id)

    def draw(self, scene: Any) -> None:
        """Add the props to a scene that is about to be drawn."""
        for shape in self._props:
            drawn = scene.geoms[scene.ngeom]
            self._mujoco.mjv_initGeom(drawn, shape.type, shape.size, shape.pos, shape.mat.ravel(), shape.rgba)
            drawn.category = shape.category
            scene.ngeom += 1

    def _shape(self, prop: Prop) -> Any:
        """A prop as MuJoCo draws it."""
        types = self._mujoco.mjtGeom
        form = {Form.BOX: types.mjGEOM_BOX, Form.SPHERE: types.mjGEOM_SPHERE, Form.CYLINDER: types.mjGEOM_CYLINDER}
        turned = self._frame.rotation * Rotation.from_euler("z", prop.yaw)
        shape = self._mujoco.MjvGeom()
        self._mujoco.mjv_initGeom(
            shape,
            form[prop.form],
            np.full(3, prop.size / 2.0),
            self._frame.to_world(prop.position),
            turned.as_matrix().ravel(),
            np.array([*prop.colour, 1.0], dtype=np.float32),
        )
        shape.category = self._mujoco.mjtCatBit.mjCAT_STATIC
        return shape
