"""Leaving out the shapes outside the view changes no pixel, in scenes at random and in tasks as perturbed."""

from contextlib import closing

import numpy as np
import pytest

from robogauntlet.adapters import catalog
from robogauntlet.adapters.mujoco_culling import view_planes
from robogauntlet.adapters.mujoco_scene import MujocoScene, import_mujoco, orbit_camera
from robogauntlet.orchestrator.kit.adapter.axes import SCENE_AXES
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.perturbations.base import ReferenceImages
from robogauntlet.orchestrator.registry import why_unadjusted
from robogauntlet.suites.episode import Condition, Episode, Protocol, RenderProfile, View
from tests.jobs import mostly_nightly

pytestmark = pytest.mark.simulator
FAST, STANDARD = RenderProfile.FAST, RenderProfile.STANDARD
SIZE = 48
SHAPES = ("sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
CORNERS = np.indices((2, 2, 2)).reshape(3, 8).T
FACES = np.array(
    [0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3]
)
FLAG = np.concatenate([0.2 * CORNERS, CORNERS * (0.002, 0.5, 0.5) + (1.0, -0.25, -0.25)])
"""Vertices of a mesh that reaches much farther to one side of its centre of mass than to the other: cube and sheet."""
SCENE = """
<mujoco>
  <visual><global offwidth="48" offheight="48" fovy="{fovy}"/><map znear=".05"/></visual><statistic extent="2"/>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1=".3 .5 .7" rgb2="0 0 0" width="32" height="32"/>
    <texture name="squares" type="2d" builtin="checker" rgb1=".6 .55 .5" rgb2=".4 .37 .35" width="64" height="64"/>
    <material name="floor" texture="squares" texrepeat="6 6"/><material name="shiny" reflectance="{reflectance}"/>
    <mesh name="mesh" vertex="{vertices}" face="{faces}"/>
  </asset>
  <worldbody>
    <light pos="1 1 3" dir="-.3 -.3 -1" castshadow="{shadows}"/>
    <geom type="plane" size="{floor} {floor} .1" pos="0 0 -1" material="floor"/>
    <body name="arm"><joint type="ball"/>{geoms}{more}<site pos=".4 0 0" size=".1"/>
      <camera name="arm" pos="0 0 .5" euler="{euler}" fovy="{fovy}"/></body>
    <camera name="flat" pos="0 -1 .5" xyaxes="1 0 0 0 .5 1" orthographic="true" fovy="1"/>
    <camera name="followed" pos="0 -2 1" mode="targetbodycom" target="arm" fovy="{fovy}"/>
    <camera name="lens" pos=".5 -1 .5" xyaxes="1 .3 0 0 .2 1" sensorsize=".06 .02" focal=".03 .02" resolution="48 48"/>
  </worldbody>
</mujoco>
"""


def scene_at_random(seed, profile, **others):
    mujoco, random = import_mujoco(), np.random.default_rng(seed)

    def numbers(low, high, count):
        return " ".join(f"{number:.4f}" for number in random.uniform(low, high, count))

    geoms = "".join(
        f'<geom type="{shape}" pos="{numbers(-1.5, 1.5, 3)}" euler="{numbers(-180, 180, 3)}" material="shiny" '
        f'size="{numbers(0.02, 0.4, 3)}" rgba="{numbers(0, 1, 3)} {random.choice([1, 1, 0.5])}" mesh="mesh"/>'.replace(
            ' mesh="mesh"' if shape != "mesh" else "#", ""
        )
        for shape in SHAPES * 4
    )
    mesh = {"vertices": " ".join(map(str, FLAG.ravel())), "faces": " ".join(map(str, [*FACES, *(8 + FACES)]))}
    fields = mesh | {
        "fovy": random.uniform(10, 100),
        "euler": numbers(-180, 180, 3),
        "floor": 0,
        "shadows": "false",
        "more": "",
    }
    text = SCENE.format(**{**fields, "reflectance": 0, "geoms": geoms, **others})
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return MujocoScene(model, data, profile)


def shapes_drawn(scene):
    return scene.renderers[SIZE].scene.ngeom


def shapes_left_out(scene, poses=4):
    """Compare the images of every camera with culling and without, and return how many shapes are not drawn in all."""
    left_out, random = 0, np.random.default_rng(0)
    for _ in range(poses):
        scene._data.qpos[:] = random.normal(size=4)
        scene._mujoco.mj_forward(scene._model, scene._data)
        for camera in ("arm", "flat", "followed", "lens", orbit_camera((0.2, 0.0, 0.0), 1.0, 30.0, -40.0)):
            culled = scene.image(camera, SIZE)
            drawn = shapes_drawn(scene)
            assert np.array_equal(culled, scene.image(camera, SIZE, culling=False))
            left_out += shapes_drawn(scene) - drawn
    return left_out


@pytest.mark.parametrize("seed", mostly_nightly(range(8), range(2)))
def test_scenes_at_random_look_the_same(seed):
    with closing(scene_at_random(seed, FAST, floor=seed % 2)) as scene:
        assert shapes_left_out(scene) > 100


def test_no_mesh_that_is_left_out_has_a_vertex_in_the_view():
    scene, random = scene_at_random(0, FAST), np.random.default_rng(0)
    mujoco, model, data = scene._mujoco, scene._model, scene._data
    drawn, found = mujoco.MjvScene(model, 100), 0
    drawn.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = drawn.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
    for azimuth, elevation in random.uniform(-180, 180, (500, 2)):
        camera = orbit_camera(random.uniform(-2, 2, 3), 0.5, azimuth, elevation)
        mujoco.mjv_updateCamera(model, data, camera, drawn)
        eye, inward, least = view_planes(drawn.camera[0])
        for number in np.flatnonzero(scene._culling.outside(data, drawn) & (model.geom_dataid >= 0)):
            vertices = data.geom_xpos[number] + model.mesh_vert @ data.geom_xmat[number].reshape(3, 3).T
            assert not ((vertices - eye) @ inward.T >= least).all(axis=1).any()
            found += 1
    assert found > 500


def test_scenes_without_shadows_and_mirrors_look_the_same_in_the_standard_profile():
    with closing(scene_at_random(8, STANDARD)) as scene:
        assert shapes_left_out(scene) > 100


def test_the_shape_that_mirrors_first_is_drawn_first_though_reflections_are_not():
    """Of two shapes in the same place the later is seen, unless it is the first that mirrors."""
    twins = '<geom type="box" size=".2 .2 .2" rgba="1 0 0 1"/><geom type="box" size=".2 .2 .2" material="shiny"/>'
    outside = '<geom type="box" pos="0 0 9" size=".1 .1 .1" mass=".01" material="shiny"/>'
    with closing(scene_at_random(0, FAST, reflectance=0.5, geoms=outside, more=twins, fovy=40)) as scene:
        shapes_left_out(scene)


@pytest.mark.parametrize("seen", [{"shadows": "true"}, {"reflectance": 0.5}])
def test_all_shapes_are_drawn_where_shadows_or_mirrors_may_show_them(seen):
    with closing(scene_at_random(0, STANDARD, **seen)) as scene:
        assert shapes_left_out(scene, poses=1) == 0


def test_the_groups_of_shapes_are_restored_also_after_an_exception(monkeypatch):
    with closing(scene_at_random(0, FAST)) as scene:
        scene.image("arm", SIZE)
        groups = scene._model.geom_group.copy()

        def fail(*_):
            assert (scene._model.geom_group != groups).any()
            raise ValueError("while the scene is updated")

        monkeypatch.setattr(scene.renderers[SIZE], "update_scene", fail)
        with pytest.raises(ValueError, match="while the scene is updated"):
            scene.image("arm", SIZE)
        assert np.array_equal(scene._model.geom_group, groups)


TASKS = [
    ("robosuite/Lift", FAST),
    ("robosuite/Door", FAST),
    ("robosuite/Stack", STANDARD),
    ("metaworld/hammer-v3", FAST),
    ("metaworld/hammer-v3", STANDARD),
    ("gymnasium/FetchReach-v4", FAST),
]


@pytest.mark.parametrize("drawn", mostly_nightly(TASKS, [TASKS[0], TASKS[4]]), ids=":".join)
def test_tasks_look_the_same_under_every_perturbation_of_the_scene(drawn):
    task, profile = drawn
    name, _, short = task.partition("/")
    simulator = catalog.find(name)
    if reason := catalog.missing_reason(simulator):
        pytest.skip(reason)
    view = View(simulator.tasks[short].cameras, SIZE, profile)
    axes = [axis for axis in SCENE_AXES if not why_unadjusted(axis, task)][:: 1 if profile is FAST else 4]
    conditions = [Condition(axis.name, 1 + number % len(axis.levels)) for number, axis in enumerate(axes)]
    with closing(simulator.open(short, view)) as simulation:
        protocol, references = Protocol(simulator.tasks[short].horizon, 8, view), ReferenceImages()
        for seed, condition in enumerate([Condition(), *conditions]):
            episode = Episode("test", "test", task, seed, protocol, condition)
            played = perturbed(simulation, episode, references)
            played.reset(seed)
            for action in np.random.default_rng(seed).uniform(-0.02, 0.02, (seed, 7)):
                played.step(action)
            images = []
            for simulation.culling in (True, False):
                images.append({**played.observe().images, "picture": played.picture()})
            assert all(np.array_equal(image, images[1][name]) for name, image in images[0].items()), condition
