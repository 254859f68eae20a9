"""Merging some parts of the network only."""

import pytest
import torch

from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged, save_merged
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.merging.errors import OutOfRange
from robogauntlet_mergevla.merging.parts import is_merged
from robogauntlet_mergevla.merging.recipe import Recipe
from tests.errors import one_line_error
from tests.mergevla.experts import TASKS, merging, plain

BLOCK_1 = "backbone.language.layers.1.mlp.up_proj.weight"


@pytest.mark.parametrize(
    ("weight", "only", "merged"),
    [
        ("backbone.vision.stems.0.0.weight", (), True),
        ("backbone.vision.stems.0.0.weight", ("vision",), True),
        ("backbone.projector.0.weight", ("vision", "trunk"), False),
        (BLOCK_1, ("language",), True),
        (BLOCK_1, ("language.1",), True),
        (BLOCK_1, ("language.0-1", "vision"), True),
        (BLOCK_1, ("language.2-9",), False),
        ("backbone.language.norm.weight", ("language.0-9",), False),
        ("action_queries", ("language",), False),
        ("action_expert.blocks.0.gate", ("trunk",), True),
    ],
)
def test_a_weight_belongs_to_its_part(weight, only, merged):
    assert is_merged(weight, only) is merged


@pytest.mark.parametrize("only", [("projector",), ("language.1",), ("vision", "trunk")])
def test_only_the_chosen_parts_differ_from_the_expert_and_a_checkpoint_keeps_them(folders, tmp_path, only):
    made = merging(folders, operator="ta", masks="none", only=only)
    save_merged(tmp_path, made)
    loaded = MergedModel(load_merged(tmp_path).parts)
    ours, own = MergedModel(made.parts).weights(TASKS[1]), plain(folders[1]).state_dict()
    apart = {name for name in own if not torch.allclose(ours[name], own[name], atol=1e-6)}
    assert apart
    assert all(is_merged(name, only) for name in apart)
    assert all(torch.equal(weight, ours[name]) for name, weight in loaded.weights(TASKS[1]).items())


def test_merging_all_parts_by_name_is_merging_everything(folders):
    parts = merging(folders, only=("vision", "projector", "language", "trunk")).parts
    named, plainly = MergedModel(parts), MergedModel(merging(folders).parts)
    for task in TASKS:
        ours, theirs = named.weights(task), plainly.weights(task)
        assert all(torch.equal(ours[name], theirs[name]) for name in theirs)


def test_merging_the_trunk_alone_is_selecting_each_tasks_adapter(folders):
    named, selected = (MergedModel(merging(folders, **o).parts) for o in ({"only": ("trunk",)}, {"backbone": "select"}))
    ours, theirs = named.weights(TASKS[2]), selected.weights(TASKS[2])
    assert all(torch.equal(ours[name], theirs[name]) for name in theirs)


def test_a_recipe_of_all_parts_is_stored_as_before():
    assert "only" not in Recipe().as_json()
    assert Recipe.from_json(Recipe(only=("vision",)).as_json()).only == ("vision",)


@pytest.mark.parametrize("part", ["visio", "language.3-1", "language.x", "language.", "action_expert", ""])
def test_a_name_that_is_no_part_is_refused(part):
    with one_line_error(OutOfRange, "expected a part to merge, vision, projector, language, trunk or blocks as"):
        Recipe(only=(part,))


def test_blocks_that_the_network_lacks_are_refused(folders):
    with one_line_error(OutOfRange, "expected blocks 0 to 1 of the language model, got 'language.1-2'"):
        merging(folders, only=("language.1-2",))
