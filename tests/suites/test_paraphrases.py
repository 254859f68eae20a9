"""Paraphrases of instructions."""

import re

import pytest

from robogauntlet.adapters.catalog import simulators, task_descriptions
from robogauntlet.suites.axes import SEVERITIES
from robogauntlet.suites.paraphrases import OTHER_GOALS, PARAPHRASES
from tests.policies.zoo import WITH_EXPERTS

MOST_WORDS = 15
"""Limit of the smallest policies."""
INSTRUCTIONS = {
    card.instruction for s in simulators().values() if not s.internal for card in s.tasks.values() if card.instruction
}


def words(sentence):
    return re.findall(r"[a-z0-9]+", sentence.lower())


def test_the_other_goals_are_goals_of_no_task():
    assert not set(OTHER_GOALS.values()) & INSTRUCTIONS
    assert all(len(words(goal)) <= MOST_WORDS for goal in OTHER_GOALS.values())


def test_every_task_with_an_expert_has_paraphrases_and_another_goal():
    instructions = {card.instruction for task, card in task_descriptions().items() if task in WITH_EXPERTS}
    assert OTHER_GOALS.keys() >= instructions
    assert PARAPHRASES.keys() >= instructions


@pytest.mark.parametrize("instruction", PARAPHRASES)
def test_paraphrases_differ_and_are_short_enough_for_the_smallest_policy(instruction):
    found = PARAPHRASES[instruction]
    assert len({instruction, *found}) == 1 + SEVERITIES
    assert all(1 < len(words(sentence)) <= MOST_WORDS for sentence in found)


@pytest.mark.parametrize("instruction", PARAPHRASES)
def test_fillers_and_irrelevant_clauses_do_not_change_the_sentence(instruction):
    filler, *_, behind = PARAPHRASES[instruction]
    assert filler.endswith(instruction)
    assert behind.endswith(instruction)


def test_no_sentence_asks_for_two_tasks():
    everything = [sentence for found in PARAPHRASES.values() for sentence in found]
    assert len(set(everything)) == len(everything)
