"""Reading and merging expert checkpoints: the report, and errors of one line."""

import pytest
import torch

from robogauntlet_mergevla.checkpoints.merge_experts import merge_experts, read_experts
from robogauntlet_mergevla.merging.errors import DifferentBases, ExpertsDiffer, MergeError, OutOfRange
from robogauntlet_mergevla.merging.recipe import BackboneRule, Recipe
from tests.errors import one_line_error
from tests.mergevla.experts import INSTRUCTIONS, TASKS, merging, save_base, save_expert
from tests.mergevla.shared import SMALL

BLOCKS = SMALL.language.layers


def test_the_report_compares_masks_with_chance_and_counts_bytes(folders):
    report = merging(folders).report
    assert report.experts == TASKS
    assert set(report.observed.keep) == set(report.null.keep) == set(report.bytes_per_task) == set(TASKS)
    assert len(report.block_distances["action_expert"]) == BLOCKS
    assert min(report.block_distances["action_expert"]) > 0


def test_selected_adapters_count_as_the_tasks_own_bytes(folders):
    merged, selected = (merging(folders, backbone=rule).report.bytes_per_task[TASKS[0]] for rule in BackboneRule)
    assert selected.head > merged.head
    assert selected.mask < merged.mask


def test_a_merge_without_task_vectors_has_a_report(folders):
    made = merging(folders, backbone="select", trunk="mean")
    assert made.report.entries == 0
    assert not made.parts.merged.masks


def refused(kind, match, *folders, **recipe):
    with one_line_error(kind, match):
        merging(folders, **recipe)


def test_experts_of_different_bases_are_refused(folders, tmp_path):
    other = save_expert(tmp_path / "other", save_base(tmp_path / "base", seed=9), "null/Raise", 5)
    message = "expected all experts from base .* of null/Reach, got .* for null/Raise"
    refused(DifferentBases, message, *folders[:2], other)


def test_two_experts_for_a_task_are_refused(folders):
    refused(MergeError, "expected one expert per task, got a second one for null/Reach", folders[0], folders[0])


def test_a_base_is_no_expert(folders):
    refused(MergeError, "expected an expert with adapters on a base", folders[0].parents[1] / "base")


def test_no_experts_are_refused():
    refused(MergeError, "expected at least one expert")


@pytest.mark.parametrize(
    ("recipe", "match"),
    [
        ({"lambda_": 0}, r"expected lambda to be a number in \(0, 2\], got 0"),
        ({"lambda_": {"null/Reach": 3.0}}, "expected lambda"),
        ({"kept_blocks": 3}, r"whole number in \[0, 2\], got 3"),
        ({"kept_blocks": -1}, "k, the blocks kept per task, to be a whole number"),
        ({"alpha": 0.0}, "expected alpha"),
        ({"alpha": float("nan")}, "expected alpha"),
        ({"masks": "tall"}, "masks: expected 'none', 'task', 'emr' or 'signs', got 'tall'"),
        ({"rounds": 0, "masks": "signs"}, "expected rounds to be a whole number"),
        ({"rounds": 2}, "expected masks 'signs' for 2 rounds, got 'task'"),
        ({"trunk": "sum"}, "trunk: expected 'mean' or 'vectors', got 'sum'"),
        ({"backbone": "half"}, "backbone: expected 'merged' or 'select', got 'half'"),
    ],
)
def test_values_out_of_range_are_refused(folders, recipe, match):
    refused(OutOfRange, match, *folders, **recipe)


def test_a_task_without_an_instruction_is_refused(folders, tmp_path):
    unknown = save_expert(tmp_path / "odd", folders[0].parents[1] / "base", "nowhere/Odd", 4)
    with pytest.raises(MergeError, match="expected an instruction for nowhere/Odd"):
        merge_experts(read_experts([unknown]), Recipe(), INSTRUCTIONS)


def test_a_backbone_tuned_otherwise_than_by_adapters_is_refused(folders, tmp_path):
    odd = save_expert(tmp_path / "odd", folders[0].parents[1] / "base", "null/Raise", 4, tune_all=True)
    refused(ExpertsDiffer, "expert null/Raise: expected a backbone tuned by adapters alone", *folders[:2], odd)


@pytest.mark.parametrize(
    "recipe",
    [
        {"operator": "ta", "masks": "none"},
        {"operator": "ties"},
        {"operator": "magnitude", "masks": "signs", "rounds": 2},
    ],
)
def test_a_layer_that_some_experts_did_not_adapt_is_merged_from_those_that_did(folders, tmp_path, recipe):
    base = folders[0].parents[1] / "base"
    odd = save_expert(tmp_path / "odd", base, "null/Raise", 4, convolutions=True)
    merged = merging([*folders[:2], odd], **recipe).parts.merged
    stem = next(name for name in merged.vector if "stems" in name)
    (expert,) = read_experts([odd]).by_name.values()
    assert set(expert.factors) <= merged.vector.keys()
    assert merged.of("null/Raise")[stem].abs().max() > 0
    assert torch.isfinite(merged.of("null/Reach")[stem]).all()


def test_weights_that_an_expert_did_not_adapt_stay_the_bases_under_signs(folders, tmp_path):
    odd = save_expert(tmp_path / "odd", folders[0].parents[1] / "base", "null/Raise", 4, convolutions=True)
    merged = merging([*folders[:2], odd], operator="magnitude", masks="signs").parts.merged
    stem = next(name for name in merged.vector if "stems" in name)
    assert (merged.of("null/Reach")[stem] == 0).all()


def test_heads_are_stored_in_bf16_under_signs(folders):
    exact, halved = (merging(folders, operator="magnitude", masks=rule) for rule in ("task", "signs"))
    task = TASKS[0]
    assert halved.report.bytes_per_task[task].head == exact.report.bytes_per_task[task].head / 2
    for name, weight in exact.parts.heads[task].items():
        torch.testing.assert_close(halved.parts.heads[task][name].float(), weight, rtol=2**-8, atol=0)


def test_ranks_may_differ(folders, tmp_path):
    wide = save_expert(tmp_path / "wide", folders[0].parents[1] / "base", "null/Raise", 4, rank=4)
    assert merging([*folders[:2], wide]).parts.merged.experts == TASKS
