"""Functions and callable objects as policies: an object with `reset` plays one episode at a time, from its reset on."""

from dataclasses import replace

import numpy as np
import pytest

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Observation
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.contract import PolicyError, Query
from robogauntlet.policies.function_policy import as_policy
from robogauntlet.policies.remote.protocol import greeting_of
from robogauntlet.suites.episode import Episode, Protocol, View
from tests.errors import one_line_error

OBSERVATION = Observation({"wrist": np.zeros((4, 4, 3), np.uint8)}, np.zeros(8), "reach the goal")


class Counter:
    """Answers with the number of its queries since its reset."""

    def __init__(self, scale=1.0):
        self.scale, self.queries = scale, 0

    def reset(self):
        self.queries = 0

    def __call__(self, images, proprioception, instruction):
        self.queries += 1
        return np.full((1, 7), self.scale * self.queries)


def episode(seed):
    return Episode("mine", "0", "null/Reach", seed, Protocol(12, 4, View(image_size=16)))


def test_a_function_answers_with_the_numbers_of_the_arms_that_it_is_shown():
    def act(images, proprioception, instruction):
        return np.zeros((1, 7 * len(proprioception) // 8))

    for numbers in (8, 16):
        query = Query(episode(0), 0, replace(OBSERVATION, proprioception=np.zeros(numbers)))
        assert as_policy(act, {}, "m:act").act([query])[0].actions.shape == (1, 7 * numbers // 8)
    with one_line_error(PolicyError, r"act: expected an action chunk of shape \(n, 14\) with n >= 1, got \(1, 7\)"):
        as_policy(lambda images, proprioception, instruction: np.zeros((1, 7)), {}, "m:act").act([query])


def answers(policy, *seeds):
    """The first number of the answer to a query of each of these episodes."""
    return [float(d.actions[0, 0]) for d in policy.act([Query(episode(seed), 0, OBSERVATION) for seed in seeds])]


def test_reset_is_called_at_the_start_of_each_episode():
    policy = as_policy(Counter, {"scale": 2.0}, "m:Counter")
    seen = []
    for seed in range(2):
        policy.reset([episode(seed)])
        seen.append([*answers(policy, seed), *answers(policy, seed)])
        policy.finish([episode(seed)])
    assert seen == [[2.0, 4.0]] * 2


def test_rows_do_not_depend_on_what_was_played_before():
    simulation = catalog.open_simulation("null/Reach", View(image_size=16))
    policy = as_policy(Counter, {"scale": 0.001}, "m:Counter")
    rows = [rollout(simulation, policy, episode(seed)) for seed in (0, 1, 0)]
    assert rows[0].actions_hash == rows[2].actions_hash
    assert rows[0].final_state_hash == rows[2].final_state_hash


def test_simultaneous_episodes_have_objects_of_their_own():
    built = []

    def build():
        built.append(Counter())
        return built[-1]

    policy = as_policy(build, {}, "m:build")
    policy.reset([episode(0), episode(1)])
    assert answers(policy, 0, 0, 1, 0) == [1.0, 2.0, 1.0, 3.0]
    policy.finish([episode(0), episode(1)])
    policy.reset([episode(2), episode(3)])
    assert answers(policy, 2, 3) == [1.0, 1.0]
    assert len(built) == 2, "objects of finished episodes are used again"


def test_an_episode_that_is_begun_again_starts_afresh():
    policy = as_policy(Counter, {}, "m:Counter")
    policy.reset([episode(0)])
    answers(policy, 0)
    policy.reset([episode(0)])
    assert answers(policy, 0) == [1.0]


def test_one_object_refuses_a_second_simultaneous_episode():
    policy = as_policy(Counter(), {}, "m:counter")
    policy.reset([episode(0)])
    with one_line_error(
        PolicyError, "expected an object for each simultaneous episode, .* the same one twice; name its"
    ):
        policy.reset([episode(1)])
    policy.finish([episode(0)])
    policy.reset([episode(1)])
    assert answers(policy, 1) == [1.0]


def test_an_object_whose_reset_fails_once_plays_the_next_episode():
    class Fragile(Counter):
        def reset(self):
            if not self.queries:
                self.queries = 1
                raise OSError("no memory")
            super().reset()

    fragile = Fragile()
    policy = as_policy(lambda: fragile, {}, "m:fragile")
    with pytest.raises(OSError, match="no memory"):
        policy.reset([episode(0)])
    policy.reset([episode(1)])
    assert answers(policy, 1) == [1.0]


def test_a_callable_with_an_activation_called_act_is_no_policy_of_the_contract():
    class Network(Counter):
        act = staticmethod(np.tanh)

    policy = as_policy(Network, {}, "m:Network")
    policy.reset([episode(0)])
    assert answers(policy, 0) == [1.0]


def test_servers_know_which_policy_keeps_state():
    function = as_policy(lambda images, proprioception, instruction: np.zeros((1, 7)), {}, "m:f")
    assert not greeting_of(function, "0").remembers
    assert greeting_of(as_policy(Counter, {}, "m:Counter"), "0").remembers


def test_a_module_whose_call_takes_anything_is_called_with_the_three_names():
    class Network:
        def __call__(self, *values, **named):
            assert set(named) == {"images", "proprioception", "instruction"}
            return np.zeros((3, 7))

    policy = as_policy(Network, {}, "m:Network")
    assert policy.act([Query(episode(0), 0, OBSERVATION)])[0].actions.shape == (3, 7)


def of_any_names(**observation):
    return np.zeros((8, 7))


class ActsOnNames:
    """An `act` with the parameters of a function, which the contract's has not."""

    def reset(self, episodes):
        pass

    def act(self, **observation):
        return np.zeros((8, 7))

    def finish(self, episodes):
        pass


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (
            ActsOnNames,
            r"found act\(self, \*\*observation\); write __call__\(self, images, proprioception, instruction\)",
        ),
        (of_any_names, r"found of_any_names\(\*\*observation\); write def of_any_names\(images, proprioception, instr"),
    ],
)
def test_an_observation_taken_by_any_name_is_refused_with_what_to_write(target, message):
    with one_line_error(PolicyError, message):
        as_policy(target, {}, f"m:{target.__name__}")


def test_a_factory_of_any_options_is_called_with_its_options():
    policy = as_policy(lambda **options: Counter(**options), {"scale": 3.0}, "m:factory")
    policy.reset([episode(0)])
    assert answers(policy, 0) == [3.0]
