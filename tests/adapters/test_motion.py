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


@pytest.mark.simulator
@pytest.mark.parametrize("task", ["robosuite/Lift", "robosuite/Lift@Jaco"])
def test_motion_equals_to_the_bit_what_arrays_of_mujoco_say(task):
    simulation = open_simulation(task, VIEW)
    simulation.reset(0)
    data, contacts = simulation._data, simulation._contacts
    low, high = np.array(contacts._limits).T
    forces = []
    for _ in range(40):
        simulation.step(np.array([0.0, 0.0, -0.05, 0.0, 0.0, 0.0, 1.0]))
        motion, joints, force, total = simulation.motion(()), data.qpos[contacts._joints], np.zeros(6), 0.0
        for contact in np.flatnonzero(np.array(contacts._weights)[data.contact.geom].sum(axis=1) == 1):
            simulation._mujoco.mj_contactForce(simulation._model, data, contact, force)
            total += force[0]
        assert motion.contact_force == total
        assert motion.joint_margin == np.minimum(joints - low, high - joints).min()
        assert motion.opening == simulation.privileged_state()["finger_positions"].sum()
        assert (motion.tool == simulation.motion(("tcp_position",)).entries[0]).all()
        forces.append(total)
    simulation.close()
    assert max(forces) > 0.0  # the hand is pressed onto the table


@pytest.mark.simulator
def test_motion_equals_to_the_bit_what_all_points_of_sapien_say():
    simulation = open_simulation("maniskill/PushCube-v1", VIEW)
    simulation.reset(0)
    physics, links = simulation._env.scene.px, {link.entity.name for link in simulation._contacts._robots[0].links}
    touchable, forces = links | {entity.name for entity in simulation._objects.values()}, []
    for _ in range(40):
        simulation.step(np.array([0.0, 0.0, -0.05, 0.0, 0.0, 0.0, 1.0]))
        total = 0.0
        for contact in physics.get_contacts():
            names = {body.entity.name for body in contact.bodies}
            if names & links and not names <= touchable:
                total += sum(abs(float(point.impulse @ point.normal)) for point in contact.points)
        assert simulation.motion(()).contact_force == total / physics.timestep
        forces.append(total)
    simulation.close()
    assert max(forces) > 0.0


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
