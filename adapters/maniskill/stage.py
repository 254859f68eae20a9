"""Paints the table of ManiSkill's scenes and puts props on it. All of it is drawn only: PhysX knows nothing of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray, Image
from robogauntlet.adapters.photometry import linear
from robogauntlet.adapters.scene_control import Form, Prop

TABLE = "table-workspace"
ABOVE = 5e-4
"""Of the painted sheet above the table, half of what the goal region has (m)."""
UPRIGHT = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0])
"""Quaternion wxyz that turns SAPIEN's cylinders, which lie along x, to stand."""


class ManiSkillStage:
    """See `robogauntlet.adapters.scene_control.TableControl`. A table is painted by a sheet that covers it."""

    def __init__(self, env: Any, base_from_world: Any) -> None:
        """Args: env: ManiSkill's environment, whose table's surface is at height 0; base_from_world: SAPIEN pose."""
        self._env, self._base_from_world = env, base_from_world
        self.table_height = float(base_from_world.p[2])
        self._props: list[Any] = []
        self._sheet: Any = None

    def undo(self) -> None:
        """Take away the props and the paint."""
        self.show([])
        self._uncover()

    def show(self, props: Sequence[Prop]) -> None:
        """Draw props in place of those before, until the next reset."""
        for entity in self._props:
            entity.remove_from_scene()
        self._props = [self._drawn(_shape(prop), self._pose(prop), "prop") for prop in props]

    def shown(self) -> Sequence[FloatArray]:
        """Where the props are now, as SAPIEN has them."""
        return [(self._base_from_world * entity.pose).p.astype(np.float64) for entity in self._props]

    def paint_table(self, texture: Image) -> None:
        """Draw the table's surface with a texture, until the next reset.

        From above, with the robot at the bottom, the texture is upright.
        """
        import sapien

        self._uncover()
        table = self._env.scene.actors[TABLE]._objs[0].find_component_by_type(sapien.render.RenderBodyComponent)
        low, high = table.compute_global_aabb_tight()[:, :2]
        self._sheet = self._drawn(_plane(low, high, texture), sapien.Pose([0.0, 0.0, ABOVE]), "paint")

    def _uncover(self) -> None:
        if self._sheet is not None:
            self._sheet.remove_from_scene()
            self._sheet = None

    def _drawn(self, shape: Any, pose: Any, name: str) -> Any:
        """A new entity of the scene with this shape."""
        import sapien

        body = sapien.render.RenderBodyComponent()
        body.attach(shape)
        entity = sapien.Entity()
        entity.name = name
        entity.add_component(body)
        entity.set_pose(pose)
        self._env.scene.sub_scenes[0].add_entity(entity)
        return entity

    def _pose(self, prop: Prop) -> Any:
        """A prop's, in the world."""
        import sapien

        turn = Rotation.from_euler("z", prop.yaw).as_quat()
        return self._base_from_world.inv() * sapien.Pose(prop.position, np.roll(turn, 1))


def _shape(prop: Prop) -> Any:
    """What is drawn of a prop, without gloss."""
    import sapien

    half = prop.size / 2
    material = _matt([*linear(255 * np.array(prop.colour)), 1.0])
    if prop.form is Form.BOX:
        return sapien.render.RenderShapeBox([half] * 3, material)
    if prop.form is Form.SPHERE:
        return sapien.render.RenderShapeSphere(half, material)
    cylinder = sapien.render.RenderShapeCylinder(half, half, material)
    cylinder.local_pose = sapien.Pose(q=UPRIGHT)
    return cylinder


def _plane(low: FloatArray, high: FloatArray, texture: Image) -> Any:
    """A sheet between two corners (2,) with a texture stretched over it."""
    import sapien

    corners = [[high[0], high[1], 0], [high[0], low[1], 0], [low[0], low[1], 0], [low[0], high[1], 0]]
    uvs = [[0, 0], [1, 0], [1, 1], [0, 1]]
    material = _matt([1.0, 1.0, 1.0, 1.0])
    opaque = np.dstack([texture, np.full(texture.shape[:2], 255, np.uint8)])
    material.base_color_texture = sapien.render.RenderTexture2D(
        opaque, "R8G8B8A8Unorm", filter_mode="linear", address_mode="edge", srgb=True
    )
    return sapien.render.RenderShapeTriangleMesh(
        np.array(corners, np.float32),
        np.array([[0, 2, 1], [0, 3, 2]], np.uint32),
        np.tile(np.array([0, 0, 1], np.float32), (4, 1)),
        np.array(uvs, np.float32),
        material,
    )


def _matt(colour: Sequence[float]) -> Any:
    """A material as ManiSkill's cubes have it."""
    import sapien

    return sapien.render.RenderMaterial(base_color=colour, roughness=1.0, specular=0.0, metallic=0.0)
