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


def scene(task):
    """What stands where: a room of LIBERO's, else the suite or the task."""
    room = re.search(r"-((kitchen|livingroom|study)\d+)", task)
    return room[1] if room else task.split("-")[0]


def test_a_goal_of_other_tasks_is_one_in_all_scenes_of_the_instruction():
    scenes = defaultdict(set)
    for task, card in task_descriptions().items():
        if not card.variant_of:  # in the scenes of those tasks
            scenes[card.instruction].add(scene(task))
    assert all(goal not in scenes or scenes[own] <= scenes[goal] for own, goal in OTHER_GOALS.items())
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
