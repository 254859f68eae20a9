"""Routers that use no image."""

from collections import Counter
from dataclasses import replace

import pytest

from robogauntlet_mergevla.routing.baselines import InstructionMatchRouter, OracleRouter, RandomRouter
from robogauntlet_mergevla.routing.contract import RoutingError
from tests.mergevla.routing.synthetic import EXPERTS, observation, observations


def test_random_choices_are_uniform_and_keyed_by_the_episode(model):
    batch = [replace(observation(0), episode_id=f"{i:x}") for i in range(900)]
    routed = RandomRouter().route(batch, model)
    assert all(250 < count < 350 for count in Counter(one.choice for one in routed).values())
    assert RandomRouter().route(batch[5:6], model)[0] == routed[5]


def test_instructions_are_matched_by_their_words(model):
    one = replace(observation(0), instruction="Push the red cube!")
    routed = InstructionMatchRouter().route([one], model)[0]
    assert routed.choice == "null/Push"
    assert routed.scores == {"null/Push": 3 / 4, "null/Open": 1 / 8, "null/Reach": 0.0}
    assert routed.unknown == pytest.approx(1 / 4)


def test_without_instruction_all_scores_are_zero(model):
    routed = InstructionMatchRouter(sees_instruction=False).route(observations(2), model)
    assert all(set(one.scores.values()) == {0.0} and one.unknown == 1.0 for one in routed)


def test_the_oracle_router_chooses_the_true_task(model):
    batch = observations()
    assert [one.choice for one in OracleRouter().route(batch, model)] == [one.task for one in batch]


def test_the_oracle_needs_an_expert_of_the_task(model):
    with pytest.raises(RoutingError, match="expert, got 'null/Pusch'; did you mean 'null/Push'"):
        OracleRouter().route([replace(observation(0), task="null/Pusch")], model)


def test_scores_are_of_the_models_experts(model):
    assert RandomRouter().route(observations(1), model)[0].scores.keys() == set(EXPERTS)
