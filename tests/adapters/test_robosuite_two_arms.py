"""Two arms in one task of robosuite: the numbers of both, and oracles that lift with both, and hand over."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

import robogauntlet
from robogauntlet.adapters.robosuite import SIMULATOR
from robogauntlet.orchestrator.demonstrations.recorder import RecordedSimulation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.baselines import ZeroPolicy
from robogauntlet.policies.contract import PolicyMismatch, check_tasks
from robogauntlet.policies.oracles import OraclePolicy
from robogauntlet.suites.episode import Episode, Protocol, RenderProfile, View
from tests.errors import one_line_error
from tests.policies.playing import steps_to_success

TASK = "TwoArmLift@TwoPandas"
HANDOVER = "TwoArmHandover@TwoPandas"


@pytest.fixture(scope="module")
def opened():
    simulation = SIMULATOR.open(TASK, View(image_size=48, render_profile=RenderProfile.FAST_2))
    yield simulation
    simulation.close()


@pytest.mark.simulator
def test_each_arm_moves_forward_from_its_own_base_towards_the_other(opened):
    opened.reset(0)
    before = opened.privileged_state()
    forward = np.tile([0.01, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0], 2)
    for _ in range(8):
        opened.step(forward)
    after = opened.privileged_state()
    for arm in ("", "second_"):
        moved = after[f"{arm}tcp_position"] - before[f"{arm}tcp_position"]
        assert moved[0] > 0.04
        assert abs(moved[1:]).max() < 0.02
    base = before["second_base_position"]
    assert base[0] > 1.0
    assert np.allclose(base[1:], 0.0, atol=1e-6)


@pytest.mark.simulator
def test_the_oracle_lifts_the_pot_with_both_arms():
    assert None not in steps_to_success(SIMULATOR, TASK, range(3), noises=(0.0, 0.1))


@pytest.mark.simulator
def test_a_seed_decides_on_which_side_the_hammer_lies():
    with closing(SIMULATOR.open(HANDOVER, View(image_size=48))) as simulation:
        starts = []
        for seed in (0, 1, 2, 3, 0, 1, 2, 3):
            simulation.reset(seed)
            starts.append(simulation.state_hash())
    assert starts[:4] == starts[4:]


@pytest.mark.simulator
@pytest.mark.nightly
def test_the_oracle_hands_the_hammer_over():
    assert None not in steps_to_success(SIMULATOR, HANDOVER, [0])


@pytest.mark.simulator
@pytest.mark.nightly
def test_the_oracle_clears_the_bin_and_brings_the_hammer_into_it():
    assert None not in steps_to_success(SIMULATOR, "TwoArmTransport@TwoPandas", [2])


@pytest.mark.simulator
def test_the_oracle_puts_the_peg_through_the_hole_with_arms_that_have_no_gripper():
    assert None not in steps_to_success(SIMULATOR, "TwoArmPegInHole@TwoPandas", [0, 1])


@pytest.mark.simulator
def test_an_episode_is_played_and_recorded_with_all_numbers(opened):
    episode = Episode("oracle", "0", f"robosuite/{TASK}", 3, Protocol(160, 8, opened.view))
    recorded = RecordedSimulation(opened, episode, 0.1)
    played = rollout(recorded, OraclePolicy(), episode)
    recording = recorded.recording()
    assert played.status == "success"
    assert recording.actions.shape == (played.steps, 14)
    assert recording.states.shape == (played.steps, 16)


@pytest.mark.simulator
def test_an_environment_takes_and_shows_the_numbers_of_both_arms():
    with closing(robogauntlet.make(f"robosuite/{TASK}", image_size=48)) as environment:
        seen, _ = environment.reset(seed=0)
        assert environment.action_space.shape == (14,)
        assert seen["proprioception"].shape == environment.observation_space["proprioception"].shape == (16,)
        with pytest.raises(ValueError, match="expected one action of 14 finite numbers"):
            environment.step(np.zeros(7))


def test_a_policy_of_one_arm_is_refused_in_one_line():
    with one_line_error(PolicyMismatch, "TwoArmLift@TwoPandas accepts 14 numbers per action, the policy produces 7"):
        check_tasks(replace(ZeroPolicy.spec, action_dim=7), [f"robosuite/{TASK}"])
