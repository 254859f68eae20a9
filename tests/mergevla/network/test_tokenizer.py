"""Prompts: stable ids, and padding between the first token and the rest."""

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet_mergevla.network.config import TINY
from robogauntlet_mergevla.network.tokenizer import tokenizer_for, word_ids
from tests.policies.zoo import WITH_EXPERTS


def test_words_have_the_same_ids_on_every_machine_in_any_case():
    assert word_ids("Push the cube!", 1024) == word_ids("push THE cube", 1024)
    assert word_ids("push the cube", 1024) == [1, 648, 937, 876]


def test_no_two_words_of_the_tasks_with_experts_share_an_id():
    instructions = {task_descriptions()[task].instruction for task in WITH_EXPERTS}
    words = {word for instruction in instructions for word in instruction.split()}
    assert len({word_ids(word, TINY.language.vocabulary)[1] for word in words}) == len(words)


def test_padding_is_between_the_first_token_and_the_rest():
    prompts = tokenizer_for(TINY)(["push the cube", "reach"])
    assert prompts.present[:, 0].all()
    assert prompts.present[:, -1].all()
    assert prompts.present.sum(1).tolist() == [4, 2]


def test_a_long_instruction_has_all_its_words():
    long = " ".join(f"word{number}" for number in range(20))
    prompts = tokenizer_for(TINY)([long, "reach"])
    assert prompts.ids[0].tolist() == word_ids(long, TINY.language.vocabulary)
    assert prompts.present.sum(1).tolist() == [21, 2]
