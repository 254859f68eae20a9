"""The shipped zoo: complete, small, with sound metadata."""

import json

import pytest

from robogauntlet_mergevla.checkpoints.merged_metadata import MergedMetadata, merged_digest_of
from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata, digest_of
from robogauntlet_mergevla.kinds import MERGED
from robogauntlet_mergevla.options import expert_folders
from robogauntlet_mergevla.zoo import shipped, zoo_folder
from tests.policies.zoo import WITH_EXPERTS

MB = 1_000_000


DIGESTS = {
    "base": "a4cd9daa8da19804",
    "experts/maniskill__PullCube-v1": "b612ba2829a5895e",
    "experts/maniskill__PushCube-v1": "a4b0ac5f41fa013a",
    "experts/maniskill__StackCube-v1": "57720388b8cd9732",
    "experts/pybullet__PandaPickAndPlace-v3": "e4ab2ae8afa8d370",
    "experts/pybullet__PandaPush-v3": "ff343c871c978435",
    "experts/pybullet__PandaReach-v3": "0830890997a89d2c",
    "experts/robosuite__Door": "656edf59b71cf4f5",
    "experts/robosuite__Lift": "52508a0304ffef27",
    "experts/robosuite__Stack": "9025579763fede07",
    "merged": "8905dac736483eb5",
    "unmerged-int4": "e5f8c218b5e02334",
    "robust-experts": "c293e82a41698008",
    "libero-experts/libero-spatial": "bd9355ebb9872cb5",
    "libero-experts/libero-object": "397fead5ff324044",
    "libero-experts/libero-goal": "08e88465ac3557ae",
    "libero-experts/libero-10": "349b7fe98543d62c",
    "libero-merged": "2513c5de8095462e",
}
"""Part of the zoo to its digest, which is in the id of every episode that was played with it."""


MERGED_OF = {"merged": "experts", "unmerged-int4": "experts", "libero-merged": "libero-experts"}
"""Merged model to the folder of its experts."""
MERGED_MODELS = (*MERGED_OF, "robust-experts")
"""The last one holds its experts itself."""


def test_the_digests_are_those_of_the_stored_runs():
    parts = {path.parent.relative_to(zoo_folder()).as_posix() for path in zoo_folder().rglob("card.json")}
    assert parts == DIGESTS.keys()
    for part, digest in DIGESTS.items():
        assert (merged_digest_of if part in MERGED_MODELS else digest_of)(f"zoo:{part}") == digest


@pytest.mark.parametrize("part", DIGESTS)
def test_metadata_are_written_as_they_were_read(part):
    plain = json.loads((zoo_folder() / part / "card.json").read_text())
    assert (MergedMetadata if part in MERGED_MODELS else CheckpointMetadata).from_json(plain).as_json() == plain


def test_digests_of_policies_with_a_recipe_are_those_of_the_stored_runs():
    recipe = {"operator": "ta", "masks": "none", "kept_blocks": 0, "alpha": 1}
    options = {"checkpoint": "zoo:merged", "experts": "zoo:experts", "recipe": recipe}
    assert MERGED.digest(options) == "45e8178db0793745"


def test_the_zoo_is_small():
    sizes = {path.relative_to(zoo_folder()): path.stat().st_size for path in zoo_folder().rglob("*") if path.is_file()}
    assert max(sizes.values()) < 20 * MB
    assert sum(sizes.values()) <= 60 * MB


def test_there_is_an_expert_for_each_task_and_all_are_verified_by_hash():
    folders = expert_folders(shipped("zoo:experts"))
    assert folders.keys() == WITH_EXPERTS
    assert len({digest_of(str(folder)) for folder in folders.values()}) == len(folders)
    digest_of(str(shipped("zoo:base")))


@pytest.mark.parametrize("part", MERGED_OF)
def test_a_merged_model_has_these_experts_and_fitted_routers(part):
    metadata = MergedMetadata.verified(shipped(f"zoo:{part}"))
    folders = dict.fromkeys(expert_folders(shipped(f"zoo:{MERGED_OF[part]}")).values())
    assert metadata.expert_digests == {CheckpointMetadata.read(f).expert: digest_of(str(f)) for f in folders}
    assert set(metadata.routers) >= {"calibrated", "nearest-centroid"}


def test_an_expert_of_liberos_suites_has_six_tasks_of_its_own():
    folders = expert_folders(shipped("zoo:libero-experts"))
    for suite in ("spatial", "object", "goal", "10"):
        tasks = [task for task in folders if task.startswith(f"libero/{suite}-")]
        assert len(tasks) == 6
        assert {folders[task].name for task in tasks} == {f"libero-{suite}"}


def test_only_safetensors_and_json_are_shipped():
    kinds = {path.suffix for folder in zoo_folder().iterdir() if folder.is_dir() for path in folder.rglob("*.*")}
    assert kinds - {".pyc"} == {".safetensors", ".json"}


def test_the_robust_experts_need_no_other_checkpoint_but_the_base():
    metadata = MergedMetadata.verified(shipped("zoo:robust-experts"))
    assert not metadata.checkpoints
    assert len(metadata.experts) == 6
    assert set(metadata.experts) < WITH_EXPERTS
    assert "calibrated" in metadata.routers
    assert metadata.base_hash == CheckpointMetadata.read(shipped("zoo:experts") / "robosuite__Lift").base_hash
