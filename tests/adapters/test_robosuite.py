"""What is particular to robosuite; the promises of every adapter are in the conformance test."""

import copy
import sys
from contextlib import closing

import numpy as np
import pytest

from robogauntlet.adapters.contract import SimulatorUnavailable
from robogauntlet.adapters.mujoco_parts.dynamics import MujocoDynamics
from robogauntlet.adapters.mujoco_parts.lights import development
from robogauntlet.adapters.mujoco_parts.physics import MujocoPhysics
from robogauntlet.adapters.mujoco_parts.simulation import import_with_mujoco
from robogauntlet.adapters.robosuite import SIMULATOR
from robogauntlet.adapters.scene_control import DynamicsFactors, Form, Light, Prop, unit
from robogauntlet.policies.oracles.robosuite import Wipe
from robogauntlet.policies.remote.conversion import encode_observation
from robogauntlet.policies.remote.server_options import read_options
from robogauntlet.suites.episode import Episode, Protocol, RenderProfile, View

pytestmark = pytest.mark.simulator


@pytest.fixture(scope="module")
def door():
    with closing(SIMULATOR.open("Door", View(image_size=48, render_profile=RenderProfile.FAST))) as simulation:
        yield simulation


@pytest.fixture(scope="module")
def lift():
    with closing(SIMULATOR.open("Lift", View(image_size=48, render_profile=RenderProfile.FAST))) as simulation:
        yield simulation


def exact_state(simulation):
    data = simulation._data
    return np.concatenate([data.qpos, data.qvel, data.qacc, data.qacc_warmstart, data.ctrl])


def test_earlier_episodes_have_no_effect_on_the_solver(door):
    door.reset(1)
    before = exact_state(door)
    door.reset(2)
    for _ in range(5):
        door.step(np.full(7, 0.05))
    door.observe()
    door.reset(1)
    assert np.array_equal(before, exact_state(door))


def test_the_door_s_placement_is_part_of_the_state_hash(door):
    door.reset(1)
    before = door.state_hash()
    door._model.body("Door_main").pos[0] += 0.001
    assert door.state_hash() != before


def test_stepping_updates_no_observables(door):
    assert door._env.enabled_observables == set()


def test_poses_are_those_of_the_current_joint_positions(door):
    door.reset(0)
    for _ in range(5):
        door.step(np.array([0.05, 0, 0, 0, 0, 0, 0]))
    shown = door.privileged_state()["tcp_position"]
    door._mujoco.mj_forward(door._model, door._data)
    assert np.array_equal(shown, door.privileged_state()["tcp_position"])


def test_the_placement_uses_one_generator_for_objects_and_arm(door):
    door.reset(5)
    assert door._env.placement_initializer.rng is door._env.rng


def adjust_everything(simulation):
    scene_controls, before = simulation.scene_controls, simulation.privileged_state()
    scene_controls.lights.set_light(Light(np.full(3, 0.5), unit(np.array([0.8, -0.5, 0.4]))))
    scene_controls.arm.place_tool(before["tcp_position"] + [0.0, 0.05, 0.03], before["tcp_quaternion"])
    scene_controls.objects.move(next(iter(scene_controls.objects.placeable())), np.array([0.02, -0.02]))
    scene_controls.dynamics.set_dynamics(DynamicsFactors(mass=2.0, friction=3.0))
    scene_controls.table.show([Prop(Form.BOX, np.array([0.5, 0.0, 0.0]), 0.05, 0.3, (1.0, 0.0, 0.0))])
    scene_controls.table.paint_table(np.zeros((8, 8, 3), np.uint8))


def test_adjustments_have_no_effect_after_a_reset(lift):
    def play(steps):
        for _ in range(steps):
            lift.step(np.full(7, 0.05))

    lift.reset(1)
    play(10)
    before = exact_state(lift)
    lift.reset(1)
    adjust_everything(lift)
    play(5)
    lift.observe()
    lift.reset(1)
    play(10)
    assert np.array_equal(before, exact_state(lift))


def test_masses_that_are_set_are_those_of_a_model_built_with_them(door):
    door.reset(1)
    door.scene_controls.dynamics.set_dynamics(DynamicsFactors(mass=2.0))
    built = copy.copy(door._model)
    door._mujoco.mj_setConst(built, door._mujoco.MjData(built))
    for name in ("body_subtreemass", "body_invweight0", "dof_M0", "dof_invweight0"):
        own = getattr(door._model, name)
        np.testing.assert_allclose(own[1:], getattr(built, name)[1:], rtol=1e-6, atol=1e-12, err_msg=name)


def test_the_friction_of_a_contact_is_scaled_whichever_body_has_the_larger():
    import mujoco

    floor, box = "<geom type='plane' size='1 1 1'/>", "<geom type='box' size='.1 .1 .1' friction='.6 0 0'/>"
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{floor}<body name='box' pos='0 0 .09'><freejoint/>{box}</body></worldbody></mujoco>"
    )
    physics = MujocoPhysics(mujoco, model, mujoco.MjData(model), "world")
    dynamics = MujocoDynamics(physics, ["box"])
    for factor in (0.5, 3.0):
        dynamics.set_dynamics(DynamicsFactors(friction=factor))
        assert set(physics.data.contact.friction[:, 0]) == {factor}


def test_half_the_light_is_half_of_what_is_drawn_once_decoded():
    encoded = np.stack([np.arange(256), development(np.full(3, 0.5))[:, 0]]) / 255
    own, dimmed = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(dimmed, own / 2, atol=0.003)


def test_the_first_row_of_the_table_s_texture_has_the_smallest_y(lift):
    lift.reset(1)
    drawn = []
    for darker in (slice(0, 4), slice(4, 8)):
        texture = np.full((8, 8, 3), 255, np.uint8)
        texture[darker] = 0
        lift.scene_controls.table.paint_table(texture)
        drawn.append(lift.picture().astype(int).mean(axis=2))
    _, columns = np.nonzero(drawn[0] < drawn[1] - 50)
    _, others = np.nonzero(drawn[0] > drawn[1] + 50)
    assert columns.mean() < others.mean() - 100  # The camera looks along -x, with y to its right.


def test_fast_draws_neither_shadows_nor_multisampling():
    pixels = {}
    for profile in RenderProfile:
        simulation = SIMULATOR.open("Lift", View(cameras=("third_person",), image_size=48, render_profile=profile))
        simulation.reset(0)
        pixels[profile] = simulation.observe().images["third_person"]
        flags = simulation._scene.renderers[48].scene.flags
        drawn = bool(flags[simulation._mujoco.mjtRndFlag.mjRND_SHADOW])
        assert drawn == (profile is RenderProfile.STANDARD)
        simulation.close()
    assert not np.array_equal(pixels[RenderProfile.STANDARD], pixels[RenderProfile.FAST])


def test_a_missing_robosuite_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "robosuite", None)
    with pytest.raises(SimulatorUnavailable, match=r'pip install "robogauntlet\[robosuite\]"'):
        import_with_mujoco("robosuite", "robosuite")


def test_fast_2_draws_a_robot_of_fewer_triangles_that_looks_and_moves_the_same():
    images, states = [], []
    for profile in (RenderProfile.FAST, RenderProfile.FAST_2):
        simulation = SIMULATOR.open("Lift", View(image_size=96, render_profile=profile))
        simulation.reset(2)
        for _ in range(3):
            simulation.step(np.array([0.01, 0.01, -0.01, 0.0, 0.0, 0.02, 1.0]))
        images.append(simulation.observe().images)
        states.append(simulation.state_hash())
        model = simulation._model
        drawn = model.mesh_facenum[model.geom_dataid[(model.geom_group == 1) & (model.geom_dataid >= 0)]].sum()
        assert drawn > 150_000 if profile is RenderProfile.FAST else drawn < 90_000
        simulation.close()
    for camera in images[0]:
        differences = np.abs(images[0][camera].astype(int) - images[1][camera]).max(axis=2)
        assert 0 < (differences > 8).mean() < 0.03
    assert states[0] == states[1]


def test_a_task_of_several_objects_succeeds_when_all_are_in_their_places():
    simulation = SIMULATOR.open("NutAssembly", View(image_size=32, render_profile=RenderProfile.FAST))
    simulation.reset(0)
    found = []
    for nut, peg in (("SquareNut", "peg1"), ("RoundNut", "peg2")):
        joint = simulation._data.joint(f"{nut}_joint0")
        joint.qpos[:3] = simulation._data.body(peg).xpos
        joint.qvel[:] = 0.0
        outcome = simulation.step(np.zeros(7))
        found.append((outcome.reward, outcome.success))
    simulation.close()
    assert found == [(0.5, False), (1.0, True)]


def test_convention_libero_gives_the_axis_angle_of_liberos_own_function_in_all_poses_of_the_arm(door, monkeypatch):
    from robosuite.utils.transform_utils import quat2axisangle

    door.reset(0)
    monkeypatch.setattr(door, "draw", lambda camera, size: np.zeros((size, size, 3), np.uint8))
    convention = read_options({"address": "a:1", "convention": "libero"})
    episode = Episode("policy", "digest", "libero/goal-7-turn-on-stove", 0, Protocol(10))
    generator, others = np.random.default_rng(0), 0
    low, high = door._model.jnt_range[:7].T
    for _ in range(300):
        door._data.qpos[:7] = generator.uniform(low, high)
        seen = door.observe()
        turn = encode_observation(convention, seen, episode)["observation/state"][3:6]
        w, *xyz = door._data.body("robot0_right_hand").xquat
        np.testing.assert_allclose(turn, quat2axisangle(np.array([*xyz, w])), atol=1e-6)
        half = np.arctan2(np.linalg.norm(xyz), w)
        np.testing.assert_allclose(turn, 2.0 * half * np.array(xyz) / np.sin(half), atol=1e-6)
        others += np.abs(turn - seen.proprioception[3:6]).max() > 1e-3
    assert 30 < others < 270, "poses on both branches"


def test_a_seed_draws_the_dirt_which_the_oracle_wipes_off():
    with closing(SIMULATOR.open("Wipe", View(image_size=48))) as simulation:
        lines = []
        for seed in (0, 1, 0):
            simulation.reset(seed)
            lines.append(simulation.privileged_state()["dirt_places"])
        assert np.array_equal(lines[0], lines[2])
        assert not np.array_equal(lines[0], lines[1])
        before, script = simulation.state_hash(), Wipe()
        outcomes = [simulation.step(script(simulation.privileged_state())) for _ in range(130)]
        assert [outcome.reward for outcome in outcomes] == sorted(outcome.reward for outcome in outcomes)
        assert outcomes[-1].success
        simulation.reset(0)
        assert simulation.state_hash() == before
        assert simulation.privileged_state()["dirt_wiped"].sum() == 0
