"""What is particular to ManiSkill; the promises of every adapter are in the conformance test."""

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robogauntlet.adapters.contract import SimulatorUnavailable
from robogauntlet.adapters.maniskill import SIMULATOR, environment
from robogauntlet.adapters.maniskill.environment import _device_name
from robogauntlet.adapters.maniskill.robot import _command, _euler_xyz
from robogauntlet.adapters.scene_control import DynamicsFactors
from robogauntlet.orchestrator.registry import load_registry
from robogauntlet.suites.episode import CAMERAS, RenderProfile, View
from robogauntlet.suites.schema import expand_tasks


def test_euler_angles_are_those_of_the_axis_angle_vector():
    rng = np.random.default_rng(0)
    for vector in rng.uniform(-0.05, 0.05, (50, 3)):
        expected = Rotation.from_rotvec(vector).as_euler("XYZ")
        np.testing.assert_allclose(_euler_xyz(*vector, longest=0.1), expected, atol=1e-12)
    assert _euler_xyz(0.0, 0.0, 0.0, longest=0.1) == (0.0, 0.0, 0.0)


def test_too_long_rotations_keep_their_axis():
    vector = np.array([0.2, -0.1, 0.3])
    expected = Rotation.from_rotvec(0.1 * vector / np.linalg.norm(vector)).as_euler("XYZ")
    np.testing.assert_allclose(_euler_xyz(*vector, longest=0.1), expected, atol=1e-12)


def test_render_device_is_the_first_supported_one():
    summary = (
        "GPU: Broken\n  Supported: 0\nGPU: llvmpipe (LLVM 19.1.7, 256 bits)\n  Supported: 1\nGPU: Other\n  Supported: 1"
    )
    assert _device_name(summary) == "llvmpipe (LLVM 19.1.7, 256 bits)"


@pytest.fixture(scope="module")
def push():
    simulation = SIMULATOR.open("PushCube-v1", View(image_size=96))
    yield simulation
    simulation.close()


@pytest.mark.simulator
def test_a_cube_is_slowed_down_by_the_friction_that_was_asked_for(push):
    lost = []
    for factor in (1.0, 2.0):
        push.reset(0)
        push.scene_controls.dynamics.set_dynamics(DynamicsFactors(friction=factor))
        body = next(part for part in push._objects["cube"].components if hasattr(part, "linear_velocity"))
        for _ in range(5):
            push._env.scene.px.step()
        body.set_linear_velocity([0.0, 1.0, 0.0])
        push._env.scene.px.step()
        lost.append(1.0 - body.linear_velocity[1])
    assert lost[1] / lost[0] == pytest.approx(2.0, rel=0.02)


def squeeze(simulation, seed):
    """Closes the gripper about the cube and opens it: two contacts at once, whose order PhysX has to choose."""
    simulation.reset(seed)
    rng = np.random.default_rng(seed)
    states = []
    for step in range(40):
        state = simulation.privileged_state()
        action = np.concatenate([0.5 * (state["cube_position"] - state["tcp_position"]), np.zeros(4)])
        action[:6] += rng.uniform(-0.005, 0.005, 6)
        action[6] = 1.0 if step < 20 else -1.0
        simulation.step(np.clip(action, simulation.action_spec.low, simulation.action_spec.high))
        states.append(simulation.privileged_state())
    return states


@pytest.mark.simulator
def test_contacts_of_earlier_episodes_have_no_effect(push):
    forward = {seed: squeeze(push, seed) for seed in range(12)}
    for seed in reversed(range(12)):
        for first, again in zip(forward[seed], squeeze(push, seed), strict=True):
            for name, value in first.items():
                np.testing.assert_array_equal(value, again[name], err_msg=f"seed {seed}, {name}")


def shove(simulation, steps):
    """Goes behind the cube, then pushes it for what is left of the steps."""
    simulation.reset(0)
    for step in range(steps):
        state = simulation.privileged_state()
        behind = 0.5 * (state["cube_position"] + [-0.08, 0.0, 0.0] - state["tcp_position"])
        action = np.concatenate([behind if step < 10 else [0.03, 0.0, 0.0], np.zeros(3), [-1.0]])
        simulation.step(np.clip(action, simulation.action_spec.low, simulation.action_spec.high))


def rest(simulation):
    """State after state of an arm and a cube at rest, for longer than PhysX takes to let the cube sleep."""
    simulation.reset(1)
    states = []
    for _ in range(16):
        simulation.step(np.zeros(7))
        states.append(simulation.state_hash())
    return states


@pytest.mark.simulator
def test_a_cube_falls_asleep_at_the_same_step_whatever_moved_when_the_last_episode_ended(push):
    undisturbed = rest(push)
    for steps in (12, 14, 16, 18):  # 16 leave the cube moving so that its rest would begin later
        shove(push, steps)
        assert rest(push) == undisturbed


@pytest.mark.simulator
@pytest.mark.parametrize("axis", range(6))
def test_the_tool_centre_point_moves_by_what_is_commanded(push, axis):
    push.reset(1)
    before = push.privileged_state()
    action = np.zeros(7)
    action[6] = -1.0
    action[axis] = size = 0.01 if axis < 3 else 0.02
    for _ in range(8):
        push.step(action)
    action[axis] = 0.0
    for _ in range(4):
        push.step(action)
    after = push.privileged_state()
    turn = Rotation.from_quat(after["tcp_quaternion"]) * Rotation.from_quat(before["tcp_quaternion"]).inv()
    moved = np.concatenate([after["tcp_position"] - before["tcp_position"], turn.as_rotvec()])
    expected = np.zeros(6)
    expected[axis] = 8 * size
    np.testing.assert_allclose(moved, expected, atol=0.05 * 8 * size)


@pytest.mark.simulator
@pytest.mark.parametrize("task", ["PullCube-v1", "StackCube-v1"])
def test_a_control_step_is_that_of_maniskill_to_the_bit(task):
    simulation = SIMULATOR.open(task, View(image_size=16))
    env = simulation._env

    def episode(step):
        simulation.reset(5)
        rng = np.random.default_rng(5)
        outcomes = []
        for number in range(25):
            state = simulation.privileged_state()
            action = rng.uniform(-1.5, 1.5, 7) * simulation.action_spec.high
            if number < 15:  # Then away from it.
                name = "red_cube_position" if task == "StackCube-v1" else "cube_position"
                action[:3] = 0.5 * (state[name] - state["tcp_position"])
            outcomes.append((step(action), simulation.state_hash()))
        return outcomes

    def step_of_maniskill(action):
        action = np.clip(action, simulation.action_spec.low, simulation.action_spec.high)
        return bool(env.step(_command(action, simulation._arms[0]._gain))[4]["success"])

    assert episode(lambda action: simulation.step(action).success) == episode(step_of_maniskill)
    simulation.close()


@pytest.mark.simulator
def test_episodes_outlast_maniskills_own_limit(push):
    push.reset(0)
    assert not any(push.step(np.array([0, 0, 0, 0, 0, 0, -1.0])).terminated for _ in range(60))


@pytest.mark.simulator
def test_the_target_is_drawn_for_policies_and_the_profiles_draw_the_same(push):
    push.reset(0)
    images = push.observe().images
    for name in ("third_person", "wrist"):
        red, green, blue = images[name].astype(int).transpose(2, 0, 1)
        assert ((red > 180) & (green < 100) & (blue < 110)).sum() > 40, f"no red rings in {name}"
        assert ((red < 100) & (blue > red + 50)).sum() > 10, f"no blue cube in {name}"
    fast = SIMULATOR.open("PushCube-v1", View(image_size=96, render_profile=RenderProfile.FAST))
    fast.reset(0)
    for name, image in fast.observe().images.items():
        np.testing.assert_array_equal(image, images[name])
    fast.close()


@pytest.mark.simulator
def test_without_a_vulkan_driver_the_message_says_why_and_what_to_do():
    code = "from robogauntlet.adapters.maniskill.simulation import *; open_task('PushCube-v1', View())"
    nowhere = {"VK_DRIVER_FILES": "/nonexistent", "VK_ICD_FILENAMES": "/nonexistent"}
    run = subprocess.run([sys.executable, "-c", code], env=os.environ | nowhere, capture_output=True, text=True)
    assert "SimulatorUnavailable" in run.stderr.splitlines()[-1]
    assert "install a Vulkan driver" in run.stderr.splitlines()[-1]


@pytest.mark.simulator
def test_a_mesh_that_is_missing_is_no_fault_of_the_driver(monkeypatch, tmp_path):
    from mani_skill.agents.robots.panda.panda_wristcam import PandaWristCam

    urdf = tmp_path / "panda.urdf"
    urdf.write_text(Path(PandaWristCam.urdf_path).read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(PandaWristCam, "urdf_path", str(urdf))  # its meshes are beside the original
    with pytest.raises(SimulatorUnavailable, match=r"a file of mani_skill is missing \(.*; install it again: pip"):
        SIMULATOR.open("PushCube-v1", View(image_size=96))


@pytest.mark.simulator
def test_fast_2_draws_a_robot_of_fewer_triangles_that_looks_and_moves_the_same(push):
    simple = SIMULATOR.open("PushCube-v1", View(image_size=96, render_profile=RenderProfile.FAST_2))
    for simulation in (push, simple):
        simulation.reset(4)
        simulation.step(np.array([0.01, 0.01, -0.01, 0.0, 0.0, 0.02, 1.0]))
    drawn, simplified = (simulation.observe().images for simulation in (push, simple))
    np.testing.assert_array_equal(drawn["wrist"], simplified["wrist"])
    differences = np.abs(drawn["third_person"].astype(int) - simplified["third_person"]).max(axis=2)
    assert 0 < (differences > 8).mean() < 0.01
    assert push.state_hash() == simple.state_hash()
    bodies = simple._env.scene.sub_scenes[0].render_system.render_bodies
    assert sum(len(part.triangles) for body in bodies for shape in body.render_shapes for part in shape.parts) < 100_000
    simple.close()


@pytest.mark.simulator
def test_the_renderer_of_a_gpu_is_made_for_the_device_itself(monkeypatch):
    """SAPIEN finds no device by the name of a GPU's model."""
    import sapien

    made, gpu = [], SimpleNamespace(name="NVIDIA H200")
    monkeypatch.setattr(sapien.render, "RenderSystem", made.append)
    monkeypatch.setattr(environment, "_RENDERERS", {})
    for _ in range(2):
        environment._keep_renderer(gpu)
    assert made == [gpu]


@pytest.mark.simulator
def test_a_placed_arm_leaves_the_cameras_without_the_table_of_reflections(push, monkeypatch):
    push.reset(0)
    scenes = []
    monkeypatch.setattr(
        "robogauntlet.adapters.maniskill.dynamics.omit_reflections", lambda env: scenes.append(env.scene.sub_scenes[0])
    )
    state = push.privileged_state()
    push.scene_controls.arm.place_tool(state["tcp_position"] + [0.03, 0.05, 0.03], state["tcp_quaternion"])
    assert scenes == [push._env.scene.sub_scenes[0]]


@pytest.mark.simulator
@pytest.mark.nightly
def test_the_table_of_reflections_that_sapien_would_compute_changes_no_pixel(push, monkeypatch):
    push.reset(0)
    monkeypatch.setattr("robogauntlet.adapters.maniskill.dynamics.omit_reflections", bool)
    with_table = SIMULATOR.open("PushCube-v1", View(image_size=96))
    with_table.reset(0)
    for name, image in with_table.observe().images.items():
        np.testing.assert_array_equal(image, push.observe().images[name])
    with_table.close()


@pytest.mark.simulator
def test_the_table_is_painted_upright_for_a_robot_that_faces_another_way():
    simulation = SIMULATOR.open("RollBall-v1", View(image_size=48))
    simulation.reset(0)
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:32, :, 0] = 255  # The far half is red,
    texture[32:, :32, 1] = texture[32:, 32:, 2] = 255  # the near one green at the left and blue at the right.
    simulation.scene_controls.table.paint_table(texture)
    image = simulation.observe().images["third_person"].astype(int)
    simulation.close()
    (_, red), (green_row, green), (blue_row, blue) = (
        np.argwhere(image[..., colour] > 100 + np.delete(image, colour, axis=2).max(axis=2)).mean(axis=0)
        for colour in range(3)
    )
    assert red < min(green, blue)  # The camera looks from the robot's left: away from it is to the left,
    assert green_row > blue_row  # and its left is below.


@pytest.mark.simulator
def test_a_task_of_another_robot_is_native_ends_as_maniskill_says_and_repeats():
    with closing(SIMULATOR.open("RotateValveLevel0-v1@DClaw", View(CAMERAS[:1], 64))) as simulation:
        spec, ends = simulation.action_spec, []
        for seed in (3, 4, 3):
            simulation.reset(seed)
            generator = np.random.default_rng(seed)
            outcomes = [simulation.step(generator.uniform(spec.low, spec.high)) for _ in range(10)]
            ends.append(simulation.state_hash())
        assert (ends[0] == ends[2], ends[0] == ends[1]) == (True, False)
        assert not any(outcome.success or outcome.terminated for outcome in outcomes)
        seen = simulation.observe()
        robot = simulation._env.agent.robot
        np.testing.assert_array_equal(seen.proprioception, [*robot.get_qpos()[0], *robot.get_qvel()[0]])
        assert (seen.native, seen.images["third_person"].shape, simulation.picture().shape) == (
            9,
            (64, 64, 3),
            (256, 256, 3),
        )


def test_tasks_of_other_robots_are_found_by_patterns_with_their_robot_alone():
    tasks = load_registry().tasks
    assert len(SIMULATOR.tasks) == 27
    assert len(expand_tasks(["maniskill/*"], tasks)) == 11
    assert len(expand_tasks(["maniskill/*@DClaw"], tasks)) == 5
