"""What is particular to LIBERO and LIBERO-PRO, tested where both are installed (`robogauntlet env create libero`)."""

import fnmatch
import itertools
import re
import sys
from contextlib import closing
from pathlib import Path

import anyio
import numpy as np
import pytest

from robogauntlet.adapters.contract import AdapterError
from robogauntlet.adapters.libero import SIMULATOR
from robogauntlet.adapters.libero.libero_import import import_libero
from robogauntlet.adapters.libero.simulation import PATIENCE, SETTLING, STILL
from robogauntlet.adapters.libero.tasks import STORED_STATES, libero_tasks
from robogauntlet.orchestrator.kit.adapter import CHECKS
from robogauntlet.orchestrator.kit.adapter.checked_task import CheckedTask
from robogauntlet.policies.remote.libero import ROTATION, TRANSLATION, native_proprioception
from robogauntlet.suites.episode import CAMERAS, FIRST_TRAINING_SEED, RenderProfile, View
from tests.adapters.goals import check_goal
from tests.jobs import mostly_nightly
from tests.processes import run_process

pytestmark = [pytest.mark.simulator, pytest.mark.apart("libero")]
DRAWER = "spatial-4-in-top-drawer-wooden-cabinet"
"""Fixtures, one of which starts open."""
FLOOR = "object-0-alphabet-soup"
"""No fixtures."""
GOALS = ["spatial-8-next-to-plate", "object-2-salad-dressing", "goal-1-put-bowl-on-stove"]
PRO = [task for task in libero_tasks() if task.startswith("pro-")]
CHECKED = ["pro-object-goal-8-put-bowl-on-plate", "pro-task-10-4-*", "pro-swap-object-0-*", "pro-language-spatial-3-*"]
SEED, SIZE = 3, 64


@pytest.fixture(scope="module")
def drawer():
    simulation = SIMULATOR.open(DRAWER, View(CAMERAS, SIZE))
    yield simulation
    simulation.close()


@pytest.fixture(scope="module")
def floor():
    simulation = SIMULATOR.open(FLOOR, View(CAMERAS, SIZE))
    yield simulation
    simulation.close()


def exact_state(simulation):
    data = simulation._data
    return np.concatenate([data.qpos, data.qvel, data.qacc, data.qacc_warmstart, data.ctrl])


def quat2axisangle(quaternion):
    """As the evaluations of policies for LIBERO turn the hand's quaternion, xyzw, into three numbers."""
    cosine = np.clip(quaternion[3], -1.0, 1.0)
    return quaternion[:3] * 2.0 * np.arccos(cosine) / np.sqrt(1.0 - cosine**2)


def native_episode(task, actions):
    """State, images as LIBERO gives them, and proprioception after these actions under LIBERO's own protocol."""
    package, known = import_libero(), libero_tasks()[task]
    from libero.libero.envs import OffScreenRenderEnv

    env = OffScreenRenderEnv(
        bddl_file_name=str(package.description(known.libero_suite, known.name)), camera_heights=SIZE, camera_widths=SIZE
    )
    env.env.object_property_initializers = []  # Else this hard reset draws for the drawers of two models.
    env.seed(SEED)
    env.reset()
    env.set_init_state(package.stored_states(known.libero_suite, known.name)[SEED])
    for action in itertools.chain([STILL] * SETTLING, actions):
        env.step(list(action))
    state = np.concatenate([env.sim.data.qpos, env.sim.data.qvel])
    env.env.sim.forward()
    seen = env.env._get_observations(force_update=True)
    env.close()
    images = {"third_person": seen["agentview_image"], "wrist": seen["robot0_eye_in_hand_image"]}
    proprioception = np.concatenate([seen["robot0_eef_pos"], seen["robot0_eef_quat"], seen["robot0_gripper_qpos"]])
    return state, images, proprioception


@pytest.mark.nightly
@pytest.mark.parametrize("task", [DRAWER, FLOOR])
def test_fast_2_draws_fewer_triangles_that_look_and_move_the_same(task):
    images, states, triangles = [], [], []
    for profile in (RenderProfile.FAST, RenderProfile.FAST_2):
        with closing(SIMULATOR.open(task, View(CAMERAS, 96, profile))) as simulation:
            simulation.reset(SEED)
            simulation.step(np.array([0.01, 0.01, -0.01, 0.0, 0.0, 0.02, 1.0]))
            images.append(np.concatenate(list(simulation.observe().images.values())).astype(int))
            states.append(simulation.state_hash())
            meshes = simulation._model.geom_dataid[simulation._model.geom_dataid >= 0]
            triangles.append(int(simulation._model.mesh_facenum[meshes].sum()))
    assert states[0] == states[1]
    assert triangles[1] < 0.6 * triangles[0]
    assert 0 < (np.abs(images[0] - images[1]).max(axis=2) > 16).mean() < 0.03


def test_an_episode_is_liberos_own_to_the_bit_in_state_and_images(drawer):
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (8, 7))
    drawer.reset(SEED)
    for action in actions:
        drawer._step(action)
    state = np.concatenate([drawer._data.qpos, drawer._data.qvel])
    seen = drawer.observe()
    theirs, images, proprioception = native_episode(DRAWER, actions)
    assert np.array_equal(state, theirs)
    for camera, image in images.items():
        assert np.array_equal(seen.images[camera], image[::-1]), camera
    ours = native_proprioception(f"libero/{DRAWER}", seen.proprioception, seen.hand_quaternion)
    np.testing.assert_allclose(ours[:3], proprioception[:3], atol=1e-9)
    np.testing.assert_allclose(ours[3:6], quat2axisangle(proprioception[3:7]), atol=1e-6)
    np.testing.assert_allclose(ours[6:], proprioception[7:], atol=1e-9)


def test_an_action_of_the_largest_size_is_liberos_own_of_1(floor):
    np.testing.assert_allclose(floor.action_spec.high, [TRANSLATION] * 3 + [ROTATION] * 3 + [1.0])
    states = []
    for native in (True, False):
        floor.reset(0)
        for sign in (1.0, -1.0, 1.0):
            share = np.full(7, sign)
            floor._step(share) if native else floor.step(share * floor.action_spec.high)
        states.append(exact_state(floor))
    assert np.array_equal(*states)


def test_a_seed_is_a_stored_state_and_a_placement_of_the_fixtures(drawer):
    drawer.reset(1)
    fixed, bowl = drawer._model.body("wooden_cabinet_1_main").pos.copy(), drawer._states[1]
    drawer.reset(51)
    assert np.array_equal(drawer._states[51 % 50], bowl)
    moved = np.linalg.norm(drawer._model.body("wooden_cabinet_1_main").pos - fixed)
    assert 0.0 < moved < 0.03


def test_without_fixtures_seeds_from_fifty_on_repeat(floor):
    hashes = []
    for seed in (1, 51, 2):
        floor.reset(seed)
        hashes.append(floor.state_hash())
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.parametrize("name", mostly_nightly(["drawer", "floor"], ["floor"]))
def test_no_training_seed_and_no_resampled_one_starts_as_an_evaluation_does(name, request):
    simulation = request.getfixturevalue(name)

    def layout(seed):
        simulation.reset(seed)
        return simulation._sites()

    evaluated = [layout(seed) for seed in range(STORED_STATES)]
    trained = [layout(seed) for seed in range(FIRST_TRAINING_SEED, FIRST_TRAINING_SEED + 5)]
    for seed in range(5):
        simulation.resample(seed)
        trained.append(simulation._sites())
    for number, layout_of_one in enumerate(trained):
        others = [*evaluated, *trained[:number]]
        assert min(np.abs(layout_of_one - other).max() for other in others) > 0.002
    assert np.array_equal(layout(FIRST_TRAINING_SEED), trained[0])


def test_nothing_of_an_episode_is_left_by_the_next_reset(drawer):
    drawer.reset(1)
    before = exact_state(drawer)
    drawer.reset(2)
    for _ in range(5):
        drawer.step(np.full(7, 1.0))
    drawer.observe()
    drawer.reset(1)
    assert np.array_equal(before, exact_state(drawer))


def test_a_reset_leaves_numpys_global_generator_as_it_was(floor):
    np.random.seed(5)
    expected = np.random.random(3)
    np.random.seed(5)
    floor.reset(0)
    assert np.array_equal(np.random.random(3), expected)


def test_two_open_tasks_draw_their_own_scenes(drawer, floor):
    for simulation in (drawer, floor):
        simulation.reset(0)
    first = [simulation.observe().images["third_person"] for simulation in (drawer, floor)]
    again = [simulation.observe().images["third_person"] for simulation in (drawer, floor)]
    assert all(np.array_equal(*pair) for pair in zip(first, again, strict=True))
    assert np.abs(first[0].astype(int) - first[1]).mean() > 20


def test_the_render_device_names_the_assets(floor):
    assert re.search(r", LIBERO assets [0-9a-f]{8} with(out)? stand-ins$", floor.render_device())


def test_leaving_out_shapes_outside_the_view_changes_no_pixel():
    subject = CheckedTask(SIMULATOR, DRAWER)
    results = CHECKS["culling"].run(subject)
    subject.close()
    assert [str(result) for result in results] == ["culling: ok"]


def test_stepping_updates_no_observables(drawer):
    assert drawer._env.enabled_observables == set()


def test_the_state_says_how_far_objects_moved_while_they_came_to_rest(drawer):
    drawer.reset(0)
    assert drawer.privileged_state()["settling_shift"] < 0.005


def test_a_stored_state_that_does_not_come_to_rest_is_refused(floor, monkeypatch):
    falling = floor._states.copy()
    start = floor._model.jnt_qposadr[floor._model.joint("alphabet_soup_1_joint0").id]
    falling[7, 1 + start + 2] += 50.0
    monkeypatch.setattr(floor, "_states", falling)
    with pytest.raises(AdapterError, match=f"stored state 7 does not come to rest within {PATIENCE} steps"):
        floor.reset(7)


def test_a_scene_without_room_is_an_error_and_no_endless_loop(floor, monkeypatch):
    from robosuite.utils.errors import RandomizationError

    def full():
        raise RandomizationError("no room")

    monkeypatch.setattr(floor._env, "reset", full)
    with pytest.raises(AdapterError, match="found no room for its objects in 100 attempts"):
        floor.reset(0)


@pytest.mark.parametrize("task", mostly_nightly(GOALS, GOALS[:1]))
def test_success_is_progress_and_idling_is_none_by_a_task_s_goal(task):
    with closing(SIMULATOR.open(task, View(CAMERAS, SIZE))) as simulation:
        check_goal(SIMULATOR, task, simulation, SEED, steps=20)


@pytest.mark.nightly
def test_an_object_whose_shapes_are_in_a_body_fixed_to_it_stands_on_the_floor():
    task = "90-62-livingroom4-pick-salad-dressing-put-in-tray"
    with closing(SIMULATOR.open(task, View(CAMERAS, SIZE))) as simulation:
        simulation.reset(SEED)
        height = simulation.privileged_state()["new_salad_dressing_1_position"][2]
        bowl = simulation.privileged_state()["akita_black_bowl_1_position"][2]
        assert 0.03 < height - bowl < 0.06
        assert simulation.scene_controls.dynamics.dynamics().mass == 1.0


def test_libero_is_imported_where_torch_is_not():
    code = "import sys; sys.modules['torch'] = None\n"
    code += "from robogauntlet.adapters.libero.libero_import import import_libero; print(len(import_libero().task_map))"
    assert int(run_process([sys.executable, "-c", code]).stdout.split()[-1]) >= 5


@pytest.mark.nightly
def test_the_stored_tasks_are_those_of_the_package():
    from libero.libero.benchmark import get_benchmark

    from robogauntlet.adapters.libero import generate_tasks, tasks

    kept = Path(tasks.__file__).with_name("tasks.json").read_text(encoding="utf-8")
    assert generate_tasks.written(generate_tasks.survey()) == kept
    for suite, theirs in tasks.SUITES.items():
        instructions = [task.language for task in get_benchmark(theirs)().tasks]
        ours = [task for task in libero_tasks().values() if task.suite == suite]
        assert [task.published_instruction or task.instruction for task in ours] == instructions


def test_a_task_of_liberopro_starts_from_its_own_files_and_tells_the_sentence_in_them(floor):
    task = "pro-language-object-0-alphabet-soup"
    with closing(SIMULATOR.open(task, View(CAMERAS, SIZE))) as simulation:
        assert simulation.observe().instruction == "grab alphabet soup and put it into basket"
        assert simulation.privileged_state().keys() == floor.privileged_state().keys()
        assert not np.array_equal(simulation._states, floor._states)


@pytest.mark.nightly
@pytest.mark.parametrize("pattern", CHECKED)
def test_a_task_of_liberopro_keeps_the_contract(pattern):
    (task,) = fnmatch.filter(PRO, pattern)
    subject = CheckedTask(SIMULATOR, task)
    results = [result for check in CHECKS.values() for result in check.run(subject)]
    subject.close()
    assert [str(result) for result in results if result.status not in ("ok", "skipped")] == []


@pytest.mark.nightly
@pytest.mark.parametrize("task", PRO)
def test_every_task_of_liberopro_opens_and_starts_anew_without_its_goal(task):
    assert len(PRO) == 160
    with closing(SIMULATOR.open(task, View(CAMERAS, SIZE))) as simulation:
        hashes = []
        for seed in (0, 1, 0):
            simulation.reset(seed)
            hashes.append(simulation.state_hash())
            assert not simulation.step(STILL).success
        assert hashes[0] == hashes[2] != hashes[1]


@pytest.mark.nightly
def test_vla_evals_own_class_goes_through_the_same_states_and_tells_the_names_of_files(floor):
    from vla_eval.benchmarks.libero.benchmark import LIBEROBenchmark
    from vla_eval.benchmarks.libero_pro.benchmark import LIBEROProBenchmark

    theirs = LIBEROBenchmark("libero_object", env_seed=SEED)
    anyio.run(theirs.start_episode, theirs.get_tasks()[0] | {"episode_idx": SEED})
    floor.reset(SEED)
    data = theirs._env.sim.data
    for action in np.random.default_rng(1).uniform(-1.0, 1.0, (8, 7)):
        theirs.step({"actions": action})
        floor._step(action)
        states = [np.concatenate([one.qpos, one.qvel]) for one in (data, floor._data)]
        assert np.array_equal(*states)
    theirs.cleanup()
    told = LIBEROProBenchmark("libero_goal", "task").get_tasks()[7]["name"]
    assert told == SIMULATOR.tasks["pro-task-goal-7-turn-on-stove"].published_instruction
