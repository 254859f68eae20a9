"""What only robosuite's adapter promises. What every simulator promises is in the conformance tests."""

from collections.abc import Iterator

import numpy as np
import pytest

from adapters.contract import FloatArray, SimulatorUnavailable
from adapters.robosuite.simulation import SIMULATOR, RobosuiteSimulation, import_simulator
from suites.vocabulary import Condition, RenderProfile, View

pytestmark = pytest.mark.simulator
CLEAN = Condition()


@pytest.fixture(scope="module")
def door() -> Iterator[RobosuiteSimulation]:
    simulation = SIMULATOR.open("Door", View(image_size=48, render_profile=RenderProfile.FAST))
    yield simulation
    simulation.close()


def exact_state(simulation: RobosuiteSimulation) -> FloatArray:
    data = simulation._data
    return np.concatenate([data.qpos, data.qvel, data.qacc, data.qacc_warmstart, data.ctrl])


def test_the_door_of_an_earlier_episode_leaves_nothing_in_the_solver(door: RobosuiteSimulation) -> None:
    door.reset(1, CLEAN)
    before = exact_state(door)
    door.reset(2, CLEAN)
    for _ in range(5):
        door.step(np.full(7, 0.05))
    door.observe()
    door.reset(1, CLEAN)
    assert np.array_equal(before, exact_state(door))


def test_the_door_s_placement_is_part_of_the_state_hash(door: RobosuiteSimulation) -> None:
    door.reset(1, CLEAN)
    before = door.state_hash()
    door._model.body("Door_main").pos[0] += 0.001
    assert door.state_hash() != before


def test_stepping_updates_no_observables(door: RobosuiteSimulation) -> None:
    assert door._env.enabled_observables == set()


def test_poses_are_those_of_the_current_joint_positions(door: RobosuiteSimulation) -> None:
    door.reset(0, CLEAN)
    for _ in range(5):
        door.step(np.array([0.05, 0, 0, 0, 0, 0, 0]))
    shown = door.privileged_state()["tcp_position"]
    door._mujoco.mj_forward(door._model, door._data)
    assert np.array_equal(shown, door.privileged_state()["tcp_position"])


def test_the_placement_uses_one_generator_for_objects_and_arm(door: RobosuiteSimulation) -> None:
    door.reset(5, CLEAN)
    assert door._env.placement_initializer.rng is door._env.rng


def test_fast_draws_neither_shadows_nor_multisampling() -> None:
    pixels = {}
    for profile in RenderProfile:
        simulation = SIMULATOR.open("Lift", View(cameras=("third_person",), image_size=48, render_profile=profile))
        simulation.reset(0, CLEAN)
        pixels[profile] = simulation.observe().images["third_person"]
        flags = simulation._renderer(48).scene.flags
        drawn = bool(flags[simulation._mujoco.mjtRndFlag.mjRND_SHADOW])
        assert drawn == (profile is RenderProfile.STANDARD)
        simulation.close()
    assert not np.array_equal(pixels[RenderProfile.STANDARD], pixels[RenderProfile.FAST])


def test_a_missing_robosuite_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "robosuite", None)
    with pytest.raises(SimulatorUnavailable, match=r"pip install robogauntlet\[robosuite\]"):
        import_simulator()
