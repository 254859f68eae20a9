"""LIBERO-Plus's variants in LIBERO itself, tested where both are installed (`robogauntlet env create libero-plus`)."""

import re
from contextlib import closing

import numpy as np
import pytest

from robogauntlet.adapters import libero
from robogauntlet.adapters.contract import TaskUnavailable
from robogauntlet.adapters.libero.assets import LIBERO_PLUS, PARTS, find_assets
from robogauntlet.adapters.libero_plus import SIMULATOR, package, task_files
from robogauntlet.adapters.libero_plus.added_objects import object_files
from robogauntlet.adapters.libero_plus.generate_variants import perturbed_names, survey, written
from robogauntlet.adapters.libero_plus.package import missing_objects
from robogauntlet.adapters.libero_plus.task_files import plus_folder
from robogauntlet.adapters.libero_plus.variants import PlusAxis, variants
from robogauntlet.adapters.user_assets import variable
from robogauntlet.suites.episode import CAMERAS, View
from tests.errors import one_line_error

pytestmark = [pytest.mark.simulator, pytest.mark.apart("libero", "liberoplus")]
OWN = "goal-4-put-bowl-on-top-cabinet"
SEED, SIZE = 0, 64


def first(axis, base="goal-4", ending=""):
    """The first variant of an axis and a task."""
    return next(one for one in variants() if one.task.startswith(f"{axis}-{base}-{ending}"))


def begun(simulator, task, steps=0):
    """An episode of a task after some steps."""
    simulation = simulator.open(task, View(CAMERAS, SIZE))
    simulation.reset(SEED)
    for _ in range(steps):
        simulation.step(simulation.action_spec.high / 2)
    return simulation


@pytest.fixture(scope="module")
def own():
    with closing(begun(libero.SIMULATOR, OWN)) as simulation:
        yield simulation


def test_the_index_and_its_names_are_those_of_the_package():
    index = package.Path(package.__file__).with_name("variants.json").read_text()
    assert written(survey(plus_folder())) == index
    ours = [(one.base.libero_suite, one.name) for one in variants()]
    assert sorted(ours) == sorted(perturbed_names(plus_folder()))


def test_a_camera_variant_moves_the_third_person_camera_alone(own):
    with closing(begun(SIMULATOR, first(PlusAxis.CAMERA).task)) as moved:
        assert moved.state_hash() == own.state_hash()
        seen, usual = moved.observe().images, own.observe().images
        assert (seen["wrist"] == usual["wrist"]).all()
        assert (seen["third_person"] != usual["third_person"]).any(axis=2).mean() > 0.3
        assert moved.delivered().statistics.keys() == {"moved_m", "x", "y", "z"}


def test_a_robot_variant_pulls_the_arm_away_before_the_episode_and_says_how_far(own):
    with closing(begun(SIMULATOR, first(PlusAxis.ROBOT, ending="415").task)) as pulled:
        usual, state, delivered = own.privileged_state(), pulled.privileged_state(), pulled.delivered()
        assert delivered.statistics["posture_rad"] == pytest.approx(0.5, abs=1e-6)
        assert delivered.value > 1.0
        assert np.linalg.norm(state["tcp_position"] - usual["tcp_position"]) > 0.01
        start = pulled.state_hash()
        pulled.step(pulled.action_spec.high / 2)
        pulled.reset(SEED)
        assert pulled.state_hash() == start


def test_noise_is_in_the_third_person_images_alone_and_depends_on_the_step_alone(own):
    with closing(begun(SIMULATOR, first(PlusAxis.NOISE).task)) as noisy:
        noisy.picture()  # for videos, which must not change a row
        assert noisy.delivered().value is None
        assert noisy.state_hash() == own.state_hash()
        seen, again = noisy.observe().images, noisy.observe().images
        assert (seen["wrist"] == own.observe().images["wrist"]).all()
        assert (seen["third_person"] == again["third_person"]).all()
        assert 5.0 < noisy.delivered().value < 60.0


def test_a_language_variant_has_the_instruction_of_its_file(own):
    with closing(begun(SIMULATOR, first(PlusAxis.LANGUAGE).task)) as reworded:
        assert reworded.observe().instruction == SIMULATOR.tasks[reworded.variant.task].instruction
        assert reworded.instruction != own.instruction
        assert reworded.state_hash() == own.state_hash()
        assert reworded.delivered().value == 1.0


def test_a_layout_variant_starts_from_its_own_state_whatever_the_seed(own):
    moved = next(one for one in variants() if one.task.startswith("layout-goal-4-moved-5"))
    assert not missing_objects(moved)
    with closing(begun(SIMULATOR, moved.task)) as simulation:
        places = simulation._states[:, 10:31]
        assert (places == places[0]).all()
        assert simulation.delivered().value > 1.0
        assert simulation.state_hash() != own.state_hash()


BOX = """<mujoco model="object"><worldbody><body name="object">
<geom type="box" size=".02 .02 .03" group="0" mass=".1"/>
<geom type="box" size=".02 .02 .03" group="1" contype="0" conaffinity="0" rgba="1 0 1 1"/>
<site name="bottom_site" pos="0 0 -.03"/><site name="top_site" pos="0 0 .03"/>
<site name="horizontal_radius_site" pos=".03 0 0"/></body></worldbody></mujoco>"""
"""Without the body around it that robosuite looks for."""
MESH = '<asset><mesh name="fur" file="fur.obj"/></asset>'


def with_added(folder, layout, text):
    """A folder of LIBERO's assets and, with this text, those of the objects that a variant adds."""
    for part in find_assets().folder.iterdir():
        (folder / part.name).symlink_to(part)
    for kind in missing_objects(layout):
        path = folder / object_files()[kind]
        path.parent.mkdir(parents=True)
        path.write_text(text)
    return folder


def test_an_added_object_of_the_users_assets_stands_where_the_stored_state_says(tmp_path, monkeypatch):
    more = first(PlusAxis.LAYOUT, ending="add")
    kinds = missing_objects(more)
    monkeypatch.setenv(variable(LIBERO_PLUS), str(with_added(tmp_path, more, BOX)))
    with closing(begun(SIMULATOR, more.task)) as simulation:
        added = [one for name, one in simulation._objects.items() if name.rstrip("0123456789")[:-1] in kinds]
        own = len(simulation._objects) - len(added)
        states = simulation._states[0, 10 + 7 * own :]
        for number, one in enumerate(added):
            np.testing.assert_allclose(one.body.xpos[:2], states[7 * number : 7 * number + 2], atol=0.03)
        assert simulation.delivered().value < 5.0  # cm, LIBERO's own objects stay where they were
        image = simulation.observe().images["third_person"].astype(int)
        assert ((image[..., 0] > 60) & (image[..., 1] < 30) & (image[..., 2] > 60)).any()


def test_an_added_object_without_its_mesh_is_left_out_in_one_line(tmp_path, monkeypatch):
    more = first(PlusAxis.LAYOUT, ending="add")
    assets = with_added(tmp_path, more, BOX.replace("<worldbody>", MESH + "<worldbody>"))
    monkeypatch.setenv(variable(LIBERO_PLUS), str(assets))
    with one_line_error(TaskUnavailable) as caught:
        SIMULATOR.open(more.task, View(CAMERAS, SIZE))
    assert str(caught.value).startswith(f"{assets} lacks files in part (")
    assert "fur.obj" in str(caught.value)


@pytest.fixture
def lamps(tmp_path, monkeypatch):
    """Assets with the scene of a light variant: LIBERO's own scene with dimmer lamps."""
    lit = first(PlusAxis.LIGHT)
    scene = task_files.scene_of(plus_folder(), package._file(lit))
    assets = find_assets().folder
    for part in assets.iterdir():
        if part.name != "scenes":
            (tmp_path / part.name).symlink_to(part)
    (tmp_path / "scenes" / "lights").mkdir(parents=True)
    for part in (assets / "scenes").iterdir():
        (tmp_path / "scenes" / part.name).symlink_to(part)
    text = (assets / "scenes" / "libero_tabletop_base_style.xml").read_text()
    dimmed = re.sub(r'diffuse="[^"]*"', 'diffuse=".1 .1 .3"', text).replace('file="../', 'file="../../')
    (tmp_path / scene.xml).write_text(dimmed)
    assert all((tmp_path / part).is_dir() for part in PARTS)
    monkeypatch.setenv(variable(LIBERO_PLUS), str(tmp_path))
    return lit


def test_a_light_variant_shows_its_scene_if_the_assets_have_it(own, lamps):
    with closing(begun(SIMULATOR, lamps.task)) as lit:
        assert lit.state_hash() == own.state_hash()
        assert lit.observe().images["wrist"].mean() < 0.9 * own.observe().images["wrist"].mean()
        found = lit.delivered().statistics
        assert [found[name] for name in found if name.endswith("diffuse_r")] == pytest.approx([0.1, 0.1])
