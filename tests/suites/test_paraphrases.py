"""Paraphrases of instructions."""

import re
from collections import defaultdict

import pytest

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.suites.axes import SEVERITIES
from robogauntlet.suites.paraphrases import OTHER_GOALS, PARAPHRASES
from tests.policies.zoo import WITH_EXPERTS

MOST_WORDS = 15


def words(sentence):
    return re.findall(r"[a-z0-9]+", sentence.lower())


def test_another_goal_is_no_task_of_another_scene():
    scenes = defaultdict(set)
    for task, card in task_descriptions().items():
        scenes[card.instruction].add(task.split("-")[0])
    assert all(goal not in scenes or scenes[goal] & scenes[own] for own, goal in OTHER_GOALS.items())
    assert all(len(words(goal)) <= MOST_WORDS for goal in OTHER_GOALS.values())


def test_every_task_with_an_expert_has_paraphrases_and_another_goal():
    instructions = {card.instruction for task, card in task_descriptions().items() if task in WITH_EXPERTS}
    assert OTHER_GOALS.keys() >= instructions
    assert PARAPHRASES.keys() >= instructions


@pytest.mark.parametrize("instruction", PARAPHRASES)
def test_paraphrases_differ_and_are_short(instruction):
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
