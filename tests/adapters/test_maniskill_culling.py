"""Leaving out links that the camera cannot see changes neither a pixel nor a state."""

import numpy as np
import pytest

from robogauntlet.adapters.maniskill import SIMULATOR
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.axis import Changes
from robogauntlet.suites.episode import Condition, Episode, Protocol, View
from tests.jobs import mostly_nightly

pytestmark = pytest.mark.simulator
VIEW = View()
SCENES = {Changes.CAMERAS, Changes.LIGHTS, Changes.TABLE, Changes.OBJECTS, Changes.ARM}
CONDITIONS = [Condition(axis.name, severity) for axis in AXES.values() if axis.changes in SCENES for severity in (1, 5)]


@pytest.fixture(scope="module")
def stack():
    simulation = SIMULATOR.open("StackCube-v1", VIEW)
    yield simulation
    simulation.close()


def pixels(simulation, culling):
    """The images of both cameras and the picture of videos."""
    simulation.culling = culling
    return [*simulation.observe().images.values(), simulation.picture()]


def act(simulation, rng, steps):
    for _ in range(steps):
        simulation.step(rng.uniform(simulation.action_spec.low, simulation.action_spec.high))


@pytest.mark.parametrize("condition", mostly_nightly(CONDITIONS, CONDITIONS[1::2]), ids=str)
def test_no_pixel_changes_under_any_axis_that_changes_the_scene(stack, condition):
    seed = 100 + CONDITIONS.index(condition)
    episode = Episode("untrained", "", "maniskill/StackCube-v1", seed, Protocol(20, view=VIEW), condition)
    scene = perturbed(stack, episode)
    scene.reset(seed)
    act(scene, np.random.default_rng(seed), seed % 20)
    for culled, all_drawn in zip(pixels(stack, True), pixels(stack, False), strict=True):
        np.testing.assert_array_equal(culled, all_drawn)


def test_links_outside_the_view_are_left_out_and_come_back(stack):
    stack.reset(0)
    stack.observe()
    scene = stack._env.scene
    bodies = {body.entity.name: body for body in scene.sub_scenes[0].render_system.render_bodies}
    with stack._culling.seen_by(scene.sensors["hand_camera"].camera._render_cameras[0]):
        hidden = {name for name, body in bodies.items() if not body.visibility}
        assert {"camera_link", *(f"panda_link{i}" for i in range(8))} <= hidden
        assert not {"panda_leftfinger", "panda_rightfinger"} & hidden
    assert all(body.visibility == 1.0 for body in bodies.values())


def test_states_do_not_depend_on_what_is_drawn(stack):
    def states(culling):
        rng = np.random.default_rng(3)
        stack.reset(3)
        hashes = []
        for _ in range(4):
            pixels(stack, culling)
            act(stack, rng, 4)
            hashes.append(stack.state_hash())
        return hashes

    assert states(True) == states(False)
