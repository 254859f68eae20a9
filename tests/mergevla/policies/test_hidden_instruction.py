"""Merged policies that act without the episode's instruction."""

from dataclasses import replace

import numpy as np

from robogauntlet_mergevla.kinds import MERGED
from robogauntlet_mergevla.options import merged_options
from robogauntlet_mergevla.policies.merged_policy import MergedPolicy
from tests.mergevla.policies.test_merged_policy import merged, of_task

__all__ = ["merged"]


def test_an_expert_without_the_instruction_acts_as_if_told_that_of_the_inferred_task(merged):
    hidden = {"checkpoint": str(merged), "router": "calibrated", "sees_instruction": False}
    blind = {**hidden, "expert_sees_instruction": False}
    instructions = MergedPolicy.of(merged_options(hidden))._model.instructions

    def answers(options, asked, words):
        told = [
            replace(q, observation=replace(q.observation, instruction=w)) for q, w in zip(asked, words, strict=True)
        ]
        return MERGED.load(options).act(told)

    asked = [of_task(seed) for seed in range(6)]
    first = answers(blind, asked, ["sing a song"] * 6)
    inferred = [instructions[decision.routing.choice] for decision in first]
    for same in (answers(blind, asked, ["dance"] * 6), answers(hidden, asked, inferred)):
        assert all(np.array_equal(a.actions, b.actions) for a, b in zip(first, same, strict=True))
    heard = answers(hidden, asked, ["sing a song"] * 6)
    assert not all(np.array_equal(a.actions, b.actions) for a, b in zip(first, heard, strict=True))


def test_reading_the_instruction_is_part_of_the_policy_and_what_it_is_by_default(merged):
    options = {"checkpoint": str(merged)}
    read, hidden = ({**options, "expert_sees_instruction": sees} for sees in (True, False))
    assert MERGED.digest(options) == MERGED.digest(read) != MERGED.digest(hidden)
