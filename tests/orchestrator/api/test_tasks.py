"""`robogauntlet.make`: tasks as environments of gymnasium, with the episodes of runs."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import robogauntlet
from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import AdapterError, StepOutcome
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.contract import Decision, PolicyInput, PolicySpec
from robogauntlet.suites.conditions import read_condition
from robogauntlet.suites.episode import SUCCESS_HOLD, Episode, Protocol, View
from robogauntlet.support.errors import BadInput
from tests.errors import one_line_error


@pytest.mark.filterwarnings("ignore::UserWarning")  # proprioception has no bounds, the environment no spec
@pytest.mark.parametrize(
    "task",
    [
        "null/Reach",
        *(
            pytest.param(task, marks=[pytest.mark.simulator, *more])
            for task, *more in (
                ("pybullet/PandaReach-v3",),
                ("robosuite/Lift", pytest.mark.nightly),
                ("maniskill/PushCube-v1", pytest.mark.nightly),
            )
        ),
    ],
)
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
    environment.reset(seed=1)
    environment.simulation.step = lambda action: StepOutcome(1.0, success=True, terminated=True)
    assert environment.step(np.zeros(7))[1:] == (1.0, True, False, {"success": True, "success_now": True})
    short = robogauntlet.make("null/Reach", horizon=1)
    short.reset(seed=1)
    assert short.step(np.zeros(7))[3]


def test_where_success_counts_once_an_episode_ends_at_the_first_step_of_the_predicate():
    environment = robogauntlet.make("null/Reach", success="once")
    environment.reset(seed=1)
    steps = [environment.step(towards_the_goal(environment))[2:] for _ in range(60)]
    ended = [terminated for terminated, _, _ in steps].index(True)
    assert [info["success_now"] for _, _, info in steps[: ended + 1]] == [False] * ended + [True]
    with pytest.raises(BadInput, match=r"^success: unknown 'onec'; did you mean 'once'"):
        robogauntlet.make("null/Reach", success="onec")


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


class Looking:
    """A policy that keeps its first observation."""

    spec = PolicySpec(PolicyInput.OBSERVATION, 8)

    def reset(self, episodes):
        self.first = None

    def act(self, queries):
        self.first = self.first or queries[0].observation
        return [Decision(np.zeros((8, 7)))]

    def finish(self, episodes):
        pass


@pytest.mark.parametrize(
    ("task", "condition"),
    [
        ("null/Reach", "clean"),
        ("null/Reach", "noise@3"),
        *(
            pytest.param("pybullet/PandaPush-v3", condition, marks=[pytest.mark.simulator, *more])
            for condition, *more in (
                ("robot-start@2",),
                ("illuminance@4", pytest.mark.nightly),
                ("instruction@1", pytest.mark.nightly),
            )
        ),
    ],
)
def test_a_condition_starts_as_the_episode_of_a_run(task, condition):
    simulation, policy = catalog.open_simulation(task, View()), Looking()
    protocol = Protocol(catalog.task_descriptions()[task].horizon)
    row = rollout(simulation, policy, Episode("p", "d", task, 3, protocol, read_condition(condition)))
    simulation.close()
    with robogauntlet.make(task, condition=condition) as environment:
        environment.reset(seed=5)
        first, _ = environment.reset(seed=3)
        assert environment.simulation.state_hash() == row.state_hash
        for camera, image in policy.first.images.items():
            np.testing.assert_array_equal(first["images"][camera], image)
        np.testing.assert_array_equal(first["proprioception"], policy.first.proprioception)
        assert first["instruction"] == policy.first.instruction
        assert environment.observation_space.contains(first)
        environment.step(np.zeros(7))


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
        ({"condition": "nose@2"}, BadInput, "condition 'nose@2': unknown axis 'nose'; did you mean 'noise'?"),
        ({"condition": "noise"}, BadInput, "condition 'noise': expected one severity, such as noise@2, got 5"),
        ({"condition": "noise@2,4"}, BadInput, "expected one severity, such as noise@2, got 2"),
        ({"condition": "noise@9"}, BadInput, "condition 'noise@9': expected a severity from 0.01 to 5, got 9"),
        ({"condition": "noise@two"}, BadInput, "condition 'noise@two': expected clean, AXIS or AXIS@SEVERITY"),
        ({"condition": "illuminance@2"}, BadInput, "condition 'illuminance@2': unsupported in null/Reach: "),
    ],
)
def test_a_mistake_is_one_line(options, error, match):
    with one_line_error(error, match):
        robogauntlet.make(**{"task": "null/Reach", **options})
