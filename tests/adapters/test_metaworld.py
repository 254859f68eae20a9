"""Tests of the Meta-World adapter only; the conformance tests are common to all adapters."""

from contextlib import closing

import numpy as np
import pytest

from robogauntlet.adapters.metaworld import SIMULATOR
from robogauntlet.policies.oracles.metaworld import SCRIPTS, in_base, in_world, observation
from tests.adapters.goals import check_goal, motions, oracle_actions
from tests.jobs import mostly_nightly
from tests.policies.playing import FAST, steps_to_success

MOVES_BY_ITSELF = {"door-close-v3": 0.2, "handle-press-v3": 0.2}
"""The hand starts on the object and moves it a little, without an action."""


@pytest.fixture(scope="module")
def opened():
    pytest.importorskip("metaworld")
    simulation = SIMULATOR.open("hammer-v3", FAST)
    yield simulation
    simulation.close()


def test_all_fifty_tasks_are_declared_and_have_an_oracle():
    assert len(SIMULATOR.tasks) == 50
    assert set(SCRIPTS) == {f"metaworld/{task}" for task in SIMULATOR.tasks}


def test_no_task_has_more_steps_than_meta_world_allows_and_each_has_an_instruction():
    assert all(60 <= card.horizon <= 500 for card in SIMULATOR.tasks.values())
    assert len({card.instruction for card in SIMULATOR.tasks.values()}) == 50


@pytest.mark.simulator
def test_the_declared_tasks_are_those_that_meta_world_has():
    env_dict = pytest.importorskip("metaworld.env_dict")
    assert set(SIMULATOR.tasks) == set(env_dict.ALL_V3_ENVIRONMENTS)


@pytest.mark.simulator
def test_its_policies_get_the_observation_of_meta_world(opened):
    opened.reset(4)
    for _ in range(5):
        opened.step(np.array([0.005, 0.005, -0.01, 0.0, 0.0, 0.0, 1.0]))
    seen, own = observation(opened.privileged_state()), opened._env._get_obs()
    read = [*range(7), *range(11, 14), *range(36, 39)]
    np.testing.assert_allclose(seen[read], own[read], atol=1e-6)


@pytest.mark.simulator
def test_resets_draw_from_no_global_generator(opened):
    opened.reset(1)
    expected = opened.state_hash()
    np.random.seed(7)
    before = np.random.get_state()[1].tolist()
    opened.reset(1)
    assert opened.state_hash() == expected
    assert np.random.get_state()[1].tolist() == before


@pytest.mark.simulator
def test_an_episode_may_go_on_after_as_many_steps_as_meta_world_allows(opened):
    opened.reset(0)
    opened._env.curr_path_length = 500
    opened.step(np.zeros(7))


@pytest.mark.simulator
@pytest.mark.parametrize("task", ["reach-v3", "drawer-open-v3", "pick-place-v3"])
def test_the_oracle_succeeds_within_the_horizon(task):
    pytest.importorskip("metaworld")
    assert None not in steps_to_success(SIMULATOR, task, range(2))


@pytest.mark.simulator
@pytest.mark.parametrize("task", mostly_nightly([*SIMULATOR.tasks], [*SIMULATOR.tasks][::10]))
def test_success_is_progress_and_idling_is_none_by_the_goal_of_every_task(task):
    pytest.importorskip("metaworld")
    with closing(SIMULATOR.open(task, FAST)) as simulation:
        seed = next(n for n in range(5) if oracle_actions(SIMULATOR, task, simulation, n))
        check_goal(SIMULATOR, task, simulation, seed, idle=MOVES_BY_ITSELF.get(task, 0.1))


@pytest.mark.simulator
@pytest.mark.parametrize("task", ["drawer-open-v3", "window-close-v3", "dial-turn-v3"])
def test_the_state_after_a_reset_is_the_present_one(task):
    pytest.importorskip("metaworld")
    with closing(SIMULATOR.open(task, FAST)) as simulation:
        simulation.reset(3)
        before = simulation.privileged_state()["object_position"]
        simulation.step(np.zeros(7))
        np.testing.assert_allclose(simulation.privileged_state()["object_position"], before, atol=1e-3)


@pytest.mark.simulator
@pytest.mark.parametrize(("task", "touches"), [("button-press-v3", True), ("button-press-topdown-v3", False)])
def test_contacts_with_the_table_count_and_those_with_the_object_do_not(task, touches):
    """The oracle presses the first button with the fingertips on the table, the other from above."""
    pytest.importorskip("metaworld")
    with closing(SIMULATOR.open(task, FAST)) as simulation:
        actions = oracle_actions(SIMULATOR, task, simulation, 0)
        simulation.reset(0)
        assert any(motion.contact_force > 0.0 for motion in motions(simulation, [], actions)) == touches


@pytest.mark.simulator
def test_a_motion_has_the_values_of_the_privileged_state(opened):
    opened.reset(0)
    opened.step(np.full(7, 0.01))
    state, motion = opened.privileged_state(), opened.motion(["object_position", "goal_position"])
    np.testing.assert_allclose(motion.entries, [state["object_position"], state["goal_position"]], atol=1e-12)
    np.testing.assert_allclose(motion.tool, state["tcp_position"], atol=1e-12)
    assert motion.opening == pytest.approx(state["finger_positions"].sum())


def test_the_two_frames_are_turned_by_a_quarter():
    np.testing.assert_array_equal(in_base(np.array([0.0, 1.0, 0.5])), [1.0, 0.0, 0.5])
    np.testing.assert_array_equal(in_world(in_base(np.array([1.0, 2.0, 3.0]))), [1.0, 2.0, 3.0])
