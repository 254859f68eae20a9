"""The motion of robot and objects, as the simulators measure it."""

import numpy as np
import pytest

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.adapters.contract import AdapterError
from robogauntlet.adapters.motion import motion_reader
from robogauntlet.adapters.wrapper import SimulationWrapper
from robogauntlet.suites.episode import View
from tests.orchestrator.episodes.scripted_failures import VIEW, towards

CUBES = {"maniskill/PushCube-v1": "cube", "pybullet/PandaPush-v3": "cube", "robosuite/Lift": "cube"}


@pytest.fixture(scope="module", params=CUBES)
def task(request):
    simulation = open_simulation(request.param, VIEW)
    simulation.reset(3)
    yield simulation
    simulation.close()


def go(simulation, place, steps=60):
    """Move the closed gripper to a place, and return the motions after each step."""
    motions = []
    for _ in range(steps):
        state = simulation.privileged_state()
        simulation.step(towards(state, place, simulation.action_spec.max_translation / 2))
        motions.append(simulation.motion(()))
    return motions


@pytest.mark.simulator
def test_entries_are_those_of_the_state(task):
    names = [name for name in task.privileged_state() if name.endswith("_position")]
    before = task.state_hash()
    motion, state = task.motion(names), task.privileged_state()
    assert task.state_hash() == before
    for name, value in zip(names, motion.entries, strict=True):
        np.testing.assert_allclose(value, state[name], atol=1e-6)
    np.testing.assert_allclose(motion.tool, state["tcp_position"], atol=1e-6)
    assert motion.opening == pytest.approx(state["finger_positions"].sum(), abs=1e-6)


@pytest.mark.simulator
def test_the_table_is_a_contact_and_the_object_and_the_fingers_themselves_are_not(task):
    task.reset(3)
    cube = task.privileged_state()["cube_position"]
    free = go(task, cube + np.array([0.0, 0.0, 0.08]))
    on_cube = go(task, cube + np.array([0.0, 0.0, 0.022]), steps=20)
    assert {motion.contact_force for motion in free + on_cube} == {0.0}
    side = np.array([0.0, 0.12, 0.0])
    go(task, cube + side + (0.0, 0.0, 0.08))
    pressed = go(task, cube + side - (0.0, 0.0, 0.1))
    assert max(motion.contact_force for motion in pressed) > 10.0


@pytest.mark.simulator
def test_joints_come_nearer_to_their_limits_when_the_arm_stretches(task):
    task.reset(3)
    here = task.motion(()).joint_margin
    assert here > 0.1
    stretched = go(task, np.array([2.0, 0.0, 0.3]), steps=120)
    assert min(motion.joint_margin for motion in stretched) < here


def test_a_simulation_without_a_motion_of_its_own_is_read_by_its_state():
    simulation = open_simulation("null/Reach", View())
    simulation.reset(3)
    motion = motion_reader(SimulationWrapper(simulation))(["goal_position"])
    state = simulation.privileged_state()
    assert motion.tool.tolist() == state["tcp_position"].tolist()
    assert motion.entries[0].tolist() == state["goal_position"].tolist()
    assert (motion.contact_force, motion.joint_margin) == (None, None)
    with pytest.raises(AdapterError, match="expected an entry 'cube_position' in privileged_state"):
        motion_reader(simulation)(["cube_position"])
