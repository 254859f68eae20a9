"""The shipped zoo: complete, small, and what its cards say."""

import pytest

from adapters.catalog import task_cards
from policies.mergevla.card import digest_of
from policies.mergevla.merged_card import merged_digest_of, verified_merged_card
from policies.mergevla.merged_policy import expert_folders
from policies.zoo import ZOO, shipped
from tests.policies.zoo import WITH_EXPERTS

MB = 1_000_000


def tasks():
    return {task for task in task_cards() if task.startswith(WITH_EXPERTS)}


def test_it_is_small_enough_to_be_cloned():
    sizes = {path.relative_to(ZOO): path.stat().st_size for path in ZOO.rglob("*") if path.is_file()}
    assert max(sizes.values()) < 20 * MB
    assert sum(sizes.values()) <= 60 * MB


def test_there_is_an_expert_for_each_task_and_all_are_verified_by_hash():
    folders = expert_folders(shipped("zoo:experts"))
    assert folders.keys() == tasks()
    assert len({digest_of(str(folder)) for folder in folders.values()}) == len(folders)
    digest_of(str(shipped("zoo:base")))


def test_the_merged_model_was_made_of_these_experts_and_its_routers_are_fitted():
    card = verified_merged_card(shipped("zoo:merged"))
    folders = expert_folders(shipped("zoo:experts"))
    assert card.expert_digests == {task: digest_of(str(folder)) for task, folder in folders.items()}
    assert set(card.routers) >= {"calibrated", "nearest-centroid"}
    assert merged_digest_of("zoo:merged")


@pytest.mark.parametrize("folder", ["base", "merged"])
def test_only_safetensors_and_json_are_shipped(folder):
    kinds = {path.suffix for path in shipped(f"zoo:{folder}").rglob("*") if path.is_file()}
    assert kinds == {".safetensors", ".json"}
