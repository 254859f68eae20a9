"""What every adapter promises, checked in every task of the three simulators."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from adapters import catalog
from adapters.contract import PICTURE_SIZE, UnknownTask, UnsupportedCondition
from adapters.frames import axis_angle
from orchestrator.worker_environment import worker_environment
from suites.vocabulary import Condition, RenderProfile, View
from tests.adapters.sampling import tasks_here

pytestmark = pytest.mark.simulator
CLEAN = Condition()
SIZE = 64
TASKS = tasks_here()


@pytest.fixture(scope="module", params=TASKS)
def opened(request):
    """Each task, opened once for all tests of this module."""
    os.environ.update(worker_environment(catalog.find(request.param.partition("/")[0])))
    view = View(catalog.task_cards()[request.param].cameras, SIZE, RenderProfile.FAST)
    simulation = catalog.open_simulation(request.param, view)
    yield request.param, simulation
    simulation.close()
    simulation.close()


def actions(simulation, seed, count=40):
    unit = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 7))
    return unit * np.array([0.02] * 3 + [0.05] * 3 + [1.0])


def trace(simulation, seed, *, look=False):
    """Hashes after reset and after 40 fixed actions, and the exact state at the end."""
    simulation.reset(seed, CLEAN)
    after_reset = simulation.state_hash()
    for i, action in enumerate(actions(simulation, seed)):
        if look and i % 8 == 0:
            simulation.observe()
        simulation.step(action)
    state = simulation.privileged_state()
    exact = b"".join(np.asarray(state[name], np.float64).tobytes() for name in sorted(state)).hex()
    return after_reset, simulation.state_hash(), exact


def test_equal_seeds_give_equal_worlds_whatever_was_played_before_and_whether_or_not_anyone_looks(opened):
    _, simulation = opened
    forwards = {seed: trace(simulation, seed) for seed in range(4)}
    backwards = {seed: trace(simulation, seed, look=True) for seed in reversed(range(4))}
    assert forwards == backwards
    assert len({after_reset for after_reset, _, _ in forwards.values()}) == 4


def test_equal_seeds_give_equal_worlds_in_a_fresh_process(opened):
    task, simulation = opened
    code = (
        "import sys, json\n"
        "from adapters import catalog\n"
        "from suites.vocabulary import *\n"
        "from tests.adapters.test_contract import trace\n"
        f"s = catalog.open_simulation({task!r}, View(CAMERAS[:1], 32, RenderProfile.FAST))\n"
        "print('trace:' + json.dumps(trace(s, 2)), flush=True)\n"
        "import os; os._exit(0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False)
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("trace:")]
    assert tuple(json.loads(line.removeprefix("trace:"))) == trace(simulation, 2)


def test_an_observation_is_what_the_contract_says(opened):
    task, simulation = opened
    simulation.reset(0, CLEAN)
    observation = simulation.observe()
    assert tuple(observation.images) == simulation.observation_spec.cameras == catalog.task_cards()[task].cameras
    for image in observation.images.values():
        assert (image.shape, image.dtype) == ((SIZE, SIZE, 3), np.uint8)
        assert image.std() > 5, "the image is blank"
    assert observation.proprioception.shape == (8,)
    assert np.isfinite(observation.proprioception).all()
    assert observation.instruction


def test_the_observation_agrees_with_the_privileged_state(opened):
    _, simulation = opened
    simulation.reset(1, CLEAN)
    for action in actions(simulation, 5, 6):
        simulation.step(action)
    seen, state = simulation.observe().proprioception, simulation.privileged_state()
    np.testing.assert_allclose(seen[:3], state["tcp_position"], atol=1e-6)
    np.testing.assert_allclose(seen[3:6], axis_angle(state["tcp_quaternion"]), atol=1e-5)
    np.testing.assert_allclose(seen[6:], state["finger_positions"], atol=1e-6)


def test_the_gripper_points_down_in_the_base_frame_at_the_start(opened):
    _, simulation = opened
    simulation.reset(0, CLEAN)
    turn = simulation.observe().proprioception[3:6]
    assert np.linalg.norm(turn) == pytest.approx(np.pi, abs=0.35)
    position = simulation.privileged_state()["tcp_position"]
    assert 0.2 < position[0] < 0.9
    assert abs(position[1]) < 0.3


def test_an_observation_shows_the_present(opened):
    _, simulation = opened
    simulation.reset(0, CLEAN)
    before = simulation.observe()
    for _ in range(8):
        simulation.step(np.array([0.0, 0.02, 0.01, 0.0, 0.0, 0.0, -1.0]))
    after = simulation.observe()
    for camera in simulation.observation_spec.cameras:
        change = np.abs(before.images[camera].astype(int) - after.images[camera].astype(int))
        assert (change > 30).any(), f"{camera} shows no motion"


def test_an_observation_is_the_callers_own(opened):
    _, simulation = opened
    simulation.reset(0, CLEAN)
    first = simulation.observe()
    kept = {name: image.copy() for name, image in first.images.items()}
    for action in actions(simulation, 0, 8):
        simulation.step(action)
    simulation.observe()
    for name, image in kept.items():
        np.testing.assert_array_equal(first.images[name], image)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_translation_in_steady_motion_moves_the_tool_by_so_many_metres(opened, axis, sign):
    _, simulation = opened
    simulation.reset(0, CLEAN)
    for _ in range(3):  # up and away from the table first
        simulation.step(np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0, -1.0]))
    for _ in range(6):
        simulation.step(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]))
    action = np.zeros(7)
    action[axis], action[6] = sign * 0.01, -1.0
    for _ in range(4):
        simulation.step(action)
    start = simulation.privileged_state()["tcp_position"].copy()
    for _ in range(5):
        simulation.step(action)
    moved = simulation.privileged_state()["tcp_position"] - start
    assert sign * moved[axis] == pytest.approx(0.05, rel=0.3)
    assert np.abs(np.delete(moved, axis)).max() < 0.01


@pytest.mark.parametrize("axis", range(3))
def test_a_rotation_in_steady_motion_turns_the_tool_by_so_many_radians_or_is_declared_ignored(opened, axis):
    from scipy.spatial.transform import Rotation

    _, simulation = opened
    simulation.reset(0, CLEAN)
    for _ in range(3):
        simulation.step(np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0, -1.0]))
    action = np.zeros(7)
    action[3 + axis], action[6] = 0.03, -1.0
    for _ in range(4):
        simulation.step(action)
    start = Rotation.from_quat(simulation.privileged_state()["tcp_quaternion"])
    for _ in range(5):
        simulation.step(action)
    turned = (Rotation.from_quat(simulation.privileged_state()["tcp_quaternion"]) * start.inv()).as_rotvec()
    if ("rx", "ry", "rz")[axis] in simulation.action_spec.ignored:
        assert np.abs(turned).max() < 0.08
    else:
        assert turned[axis] == pytest.approx(0.15, rel=0.3)
        assert np.abs(np.delete(turned, axis)).max() < 0.04


def test_plus_one_closes_the_gripper_or_is_declared_ignored(opened):
    _, simulation = opened
    widths = {}
    for command in (-1.0, 1.0):
        simulation.reset(0, CLEAN)
        for _ in range(15):
            simulation.step(np.array([0.0, 0.0, 0.005, 0.0, 0.0, 0.0, command]))
        widths[command] = np.abs(simulation.privileged_state()["finger_positions"]).sum()
    if "gripper" in simulation.action_spec.ignored:
        assert widths[1.0] == pytest.approx(widths[-1.0], abs=1e-3)
    else:
        assert widths[-1.0] > 0.06
        assert widths[1.0] < 0.01


def test_a_picture_for_people_is_drawn_and_leaves_the_world_as_it_was(opened):
    _, simulation = opened
    simulation.reset(3, CLEAN)
    before = simulation.state_hash()
    picture = simulation.picture()
    assert (picture.shape, picture.dtype) == ((PICTURE_SIZE, PICTURE_SIZE, 3), np.uint8)
    assert picture.std() > 5
    assert simulation.state_hash() == before


def test_the_start_is_no_success(opened):
    _, simulation = opened
    simulation.reset(0, CLEAN)
    assert not simulation.step(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0])).success


def test_an_unknown_condition_is_refused(opened):
    _, simulation = opened
    with pytest.raises(UnsupportedCondition):
        simulation.reset(0, Condition("no-such-axis", 3))


@pytest.mark.parametrize("name", [s.name for s in catalog.simulators().values() if not s.internal])
def test_an_unknown_task_is_refused_with_the_nearest_name(name):
    task = next(iter(catalog.find(name).tasks))
    with pytest.raises(UnknownTask, match=f"did you mean '{name}/{task}'"):
        catalog.open_simulation(f"{name}/{task}x", View())
