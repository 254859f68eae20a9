"""`robogauntlet.make`: tasks as environments of gymnasium, with the episodes of runs."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import robogauntlet
from robogauntlet.adapters.contract import AdapterError
from robogauntlet.suites.episode import SUCCESS_HOLD
from robogauntlet.support.errors import BadInput
from tests.errors import one_line_error


@pytest.mark.filterwarnings("ignore::UserWarning")  # proprioception has no bounds, the environment no spec
@pytest.mark.parametrize("task", ["null/Reach", pytest.param("pybullet/PandaReach-v3", marks=pytest.mark.simulator)])
def test_an_environment_passes_the_checks_of_gymnasium(task):
    with robogauntlet.make(task, render_mode="rgb_array", image_size=32) as environment:
        check_env(environment)
        assert environment.render().shape == (256, 256, 3)


def towards_the_goal(environment):
    state = environment.simulation.privileged_state()
    return np.concatenate([state["goal_position"] - state["tcp_position"], np.zeros(4)])


def test_an_observation_has_the_parameters_of_a_policys_function():
    def act(images, proprioception, instruction):
        assert {camera: image.shape for camera, image in images.items()} == {"wrist": (24, 24, 3)}
        assert (proprioception.shape, instruction) == ((8,), "reach the goal")
        return np.zeros((2, 7))

    environment = robogauntlet.make("null/Reach", cameras=["wrist"], image_size=24)
    observation, info = environment.reset(seed=7)
    assert info == {"seed": 7}
    for action in act(**observation):
        observation, reward, terminated, truncated, info = environment.step(action)
    assert (reward, terminated, truncated, info) == (0.0, False, False, {"success": False, "success_now": False})


def test_an_episode_ends_when_the_task_has_succeeded_or_its_time_is_over():
    environment = robogauntlet.make("null/Reach")
    environment.reset(seed=1)
    steps = [environment.step(towards_the_goal(environment))[2:] for _ in range(60)]
    held = [terminated for terminated, _, _ in steps].index(True)
    assert [info["success_now"] for _, _, info in steps[: held + 1]].count(True) == SUCCESS_HOLD
    assert steps[held][2]["success"]
    assert [truncated for _, truncated, _ in steps] == [False] * 59 + [True]
    short = robogauntlet.make("null/Reach", horizon=1)
    short.reset(seed=1)
    assert short.step(np.zeros(7))[3]


def test_a_seed_is_the_episode_of_that_seed_and_none_is_a_random_one():
    environment = robogauntlet.make("null/Reach")
    environment.reset(seed=3)
    first = environment.simulation.state_hash()
    _, random = environment.reset()
    assert environment.simulation.state_hash() != first
    environment.reset(seed=random["seed"])
    repeated = environment.simulation.state_hash()
    environment.reset(seed=3)
    assert environment.simulation.state_hash() == first
    assert environment.reset()[1] == random
    assert environment.simulation.state_hash() == repeated


def test_actions_beyond_the_bounds_are_clipped_and_ignored_numbers_have_no_effect():
    environment = robogauntlet.make("null/Reach")
    before = environment.reset(seed=0)[0]["proprioception"]
    after = environment.step(np.array([9.0, 0, 0, 9.0, 9.0, 9.0, 9.0]))[0]["proprioception"]
    assert after - before == pytest.approx([0.05, *[0.0] * 7])


@pytest.mark.parametrize("action", [np.zeros((8, 7)), np.zeros(6), np.full(7, np.nan)])
def test_a_wrong_action_is_refused(action):
    environment = robogauntlet.make("null/Reach")
    environment.reset(seed=0)
    with pytest.raises(ValueError, match="expected one action of 7 finite numbers"):
        environment.step(action)


def test_a_step_needs_a_reset():
    with pytest.raises(gymnasium.error.ResetNeeded):
        robogauntlet.make("null/Reach").step(np.zeros(7))


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"task": "null/Rech"}, AdapterError, "unknown task 'null/Rech'; did you mean 'null/Reach'?"),
        ({"task": "Lift"}, AdapterError, "unknown simulator 'Lift'"),
        ({"render_mode": "human"}, BadInput, "render_mode: expected rgb_array or None, got 'human'"),
        ({"cameras": ["wirst"]}, BadInput, "null/Reach has no camera 'wirst'; did you mean 'wrist'?"),
        ({"image_size": 8}, BadInput, "image_size: expected 16 to 1024, got 8"),
        ({"render_profile": "quick"}, BadInput, "render_profile: unknown 'quick'"),
        ({"horizon": 0}, BadInput, "horizon: expected 1 or more, got 0"),
    ],
)
def test_a_mistake_is_one_line(options, error, match):
    with one_line_error(error, match):
        robogauntlet.make(**{"task": "null/Reach", **options})
