"""Paints the table of ManiSkill's scenes and adds props, which are only rendered."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import FloatArray, Image
from robogauntlet.adapters.frames import wxyz_to_xyzw
from robogauntlet.adapters.photometry import linear
from robogauntlet.adapters.scene_control import Form, Prop

TABLE = "table-workspace"
ABOVE = 5e-4
"""Height of the painted sheet above the table, half that of the goal region (m)."""
UPRIGHT = np.array([np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0])
"""Quaternion wxyz that makes SAPIEN's cylinders, which lie along x, upright."""


class ManiSkillTable:
    """`TableControl` of `scene_control`. A painted sheet covers the table."""

    def __init__(self, env: Any, base_from_world: Any) -> None:
        """Take ManiSkill's environment (table at height 0) and SAPIEN's pose of the world in the base frame."""
        self._env, self._base_from_world = env, base_from_world
        self.table_height = float(base_from_world.p[2])
        self._props: list[Any] = []
        self._sheet: Any = None

    def undo(self) -> None:
        """Remove props and paint."""
        self.show([])
        self._uncover()

    def show(self, props: Sequence[Prop]) -> None:
        """Show these props instead of the previous ones, until the next reset."""
        for entity in self._props:
            entity.remove_from_scene()
        self._props = [self._drawn(_shape(prop), self._pose(prop), "prop") for prop in props]

    def shown(self) -> Sequence[FloatArray]:
        """Return the centres of the props, from SAPIEN."""
        return [(self._base_from_world * entity.pose).p.astype(np.float64) for entity in self._props]

    def paint_table(self, texture: Image) -> None:
        """Cover the table with a texture until the next reset; seen by the robot from above, it is upright."""
        import sapien

        self._uncover()
        low, high = self._corners()[:, :2]
        turn = Rotation.from_quat(wxyz_to_xyzw(self._base_from_world.inv().q)).as_euler("zyx")[0]
        plane = _plane(low, high, texture, quarters=round(turn / (np.pi / 2)))
        self._sheet = self._drawn(plane, sapien.Pose([0.0, 0.0, ABOVE]), "paint")

    @property
    def table_edges(self) -> FloatArray:
        """Smallest and largest x and y of the surface, shape (2, 2) (m)."""
        import sapien

        corners = [(self._base_from_world * sapien.Pose(corner)).p[:2] for corner in self._corners()]
        return np.sort(np.asarray(corners, dtype=np.float64), axis=0)

    def _corners(self) -> FloatArray:
        """Smallest and largest coordinates of the table in the world, shape (2, 3) (m)."""
        import sapien

        table = self._env.scene.actors[TABLE]._objs[0].find_component_by_type(sapien.render.RenderBodyComponent)
        return np.asarray(table.compute_global_aabb_tight())

    def _uncover(self) -> None:
        if self._sheet is not None:
            self._sheet.remove_from_scene()
            self._sheet = None

    def _drawn(self, shape: Any, pose: Any, name: str) -> Any:
        """Add an entity with this shape to the scene."""
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
        """Return a prop's pose in the world."""
        import sapien

        turn = Rotation.from_euler("z", prop.yaw).as_quat()
        return self._base_from_world.inv() * sapien.Pose(prop.position, np.roll(turn, 1))


def _shape(prop: Prop) -> Any:
    """Return the shape of a prop, without gloss."""
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


def _plane(low: FloatArray, high: FloatArray, texture: Image, *, quarters: int) -> Any:
    """Return a sheet between two corners (2,) with a texture stretched over it.

    It is upright for a robot that faces along x, turned counter-clockwise by `quarters` right angles.
    """
    import sapien

    corners = [[high[0], high[1], 0], [high[0], low[1], 0], [low[0], low[1], 0], [low[0], high[1], 0]]
    uvs = np.roll([[0, 0], [1, 0], [1, 1], [0, 1]], -quarters, axis=0)
    material = _matt([1.0, 1.0, 1.0, 1.0])
    opaque = np.dstack([texture, np.full(texture.shape[:2], 255, np.uint8)])
    material.base_color_texture = sapien.render.RenderTexture2D(
        opaque, "R8G8B8A8Unorm", filter_mode="linear", address_mode="edge", srgb=True
    )
    return sapien.render.RenderShapeTriangleMesh(
        np.array(corners, np.float32),
        np.array([[0, 2, 1], [0, 3, 2]], np.uint32),
        np.tile(np.array([0, 0, 1], np.float32), (4, 1)),
        uvs.astype(np.float32),
        material,
    )


def _matt(colour: Sequence[float]) -> Any:
    """Return a material like that of ManiSkill's cubes."""
    import sapien

    return sapien.render.RenderMaterial(base_color=colour, roughness=1.0, specular=0.0, metallic=0.0)
