"""Merging expert checkpoints into one model: which weight comes from where, and what routers see of it."""

import itertools

import pytest
import torch

from policies.contract import PolicyError
from policies.mergevla.config import LoraSettings
from policies.mergevla.merged_model import SUBSPACE, MergedModel, leading
from policies.mergevla.merging.errors import DifferentBases, ExpertsDiffer, MergeError, OutOfRange
from policies.mergevla.merging.operators import UnknownOperator
from policies.mergevla.merging.recipe import BackboneRule, MaskRule, Recipe, TrunkRule
from policies.mergevla.merging_experts import merge_experts, read_experts
from tests.policies.mergevla.experts import INSTRUCTIONS, TASKS, merging, plain, save_base, save_expert, save_experts
from tests.policies.mergevla.shared import SMALL, inputs, small_model

BLOCKS = SMALL.language.layers


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    return save_experts(tmp_path_factory.mktemp("zoo"))


def same(ours, theirs, tolerance=1e-6):
    return ours.keys() == theirs.keys() and all(torch.allclose(ours[n], theirs[n], atol=tolerance) for n in ours)


@pytest.mark.parametrize("trunk", TrunkRule)
@pytest.mark.parametrize("backbone", BackboneRule)
@pytest.mark.parametrize("masks", [MaskRule.NONE, MaskRule.TASK])
def test_a_single_expert_comes_back_unchanged(folders, trunk, backbone, masks):
    model = MergedModel(merging(folders[:1], operator="ta", trunk=trunk, backbone=backbone, masks=masks).parts)
    assert same(model.weights(TASKS[0]), plain(folders[0]).state_dict())


def test_selected_adapters_and_all_blocks_kept_leave_only_the_shared_trunk_different(folders):
    model = MergedModel(merging(folders, backbone="select", kept_blocks=BLOCKS).parts)
    for task, folder in zip(TASKS, folders, strict=True):
        ours, own = model.weights(task), plain(folder).state_dict()
        apart = {name for name in own if not torch.allclose(ours[name], own[name], atol=1e-6)}
        assert apart
        assert all(name.startswith(("action_queries", "proprioception", "action_expert.input")) for name in apart)


def test_naive_merging_is_one_network_for_all_tasks(folders):
    recipe = Recipe("mean", masks=MaskRule.NONE, kept_blocks=0, merge_output=True)
    model = MergedModel(merging(folders, recipe).parts)
    owns = [plain(folder).state_dict() for folder in folders]
    mean = {name: torch.stack([own[name].float() for own in owns]).mean(0) for name in owns[0]}
    for task in TASKS:
        assert same(model.weights(task), mean)


def test_heads_are_each_experts_own_and_the_trunk_is_shared(folders):
    model = MergedModel(merging(folders, masks="none").parts)
    last = f"action_expert.blocks.{BLOCKS - 1}.output.weight"
    first = "action_expert.blocks.0.output.weight"
    weights = [model.weights(task) for task in TASKS]
    for own, folder in zip(weights, folders, strict=True):
        for name in (last, "action_expert.output.weight", "action_expert.output_norm.bias"):
            assert torch.equal(own[name], plain(folder).state_dict()[name])
    assert all(torch.equal(a[first], b[first]) for a, b in itertools.pairwise(weights))


def test_the_papers_trunk_is_the_mean_and_has_no_masks(folders):
    parts = merging(folders, trunk="mean").parts
    assert all(name.startswith("backbone.") for name in parts.merged.tau)
    name = "action_expert.blocks.0.k_task.weight"
    mean = torch.stack([plain(folder).state_dict()[name] for folder in folders]).mean(0)
    assert torch.allclose(MergedModel(parts).weights(TASKS[1])[name], mean, atol=1e-7)


def test_trunk_vectors_are_masked_as_the_backbone_is(folders):
    parts = merging(folders, operator="ta").parts
    name = "action_expert.blocks.0.k_task.weight"
    base = parts.base[name]
    taus = [plain(folder).state_dict()[name] - base for folder in folders]
    merged = sum(taus)
    expected = base + merged * (taus[2].abs() > 0.6 * (merged - taus[2]).abs())
    assert torch.allclose(MergedModel(parts).weights(TASKS[2])[name], expected, atol=1e-6)


def test_networks_run_with_the_weights_of_their_expert(folders):
    model = MergedModel(merging(folders).parts)
    assert model.experts == TASKS
    for name in (None, *TASKS):
        assert same(dict(model.model(name).state_dict()), model.weights(name), 0)
    assert torch.equal(model.model(None)(*inputs(SMALL)), small_model()(*inputs(SMALL)))


def test_only_so_many_networks_stay_in_memory(folders):
    model = MergedModel(merging(folders).parts, most_models=2)
    first = model.model(TASKS[0])
    assert model.model(TASKS[0]) is first
    for task in TASKS[1:]:
        model.model(task)
    assert model.model(TASKS[0]) is not first


def test_hidden_states_are_those_of_the_experts_backbone(folders):
    model, (images, prompts, _) = MergedModel(merging(folders).parts), inputs(SMALL, batch=2)
    instructions = ["push the cube", "open the door with the handle"]
    for name in (None, TASKS[1]):
        ours = model.hidden_states(name, images, instructions)
        theirs = model.model(name).hidden_states(images, prompts)
        assert torch.equal(ours.task[-1], theirs.task[-1])
        assert torch.equal(ours.action[1], theirs.action[1])
    with pytest.raises(PolicyError, match="an instruction for each of 2 images, got 1"):
        model.hidden_states(None, images, ["one"])


@pytest.mark.parametrize(("kept", "block"), [(0, 1), (1, 0), (2, 0)])
def test_own_value_weights_have_the_leading_right_singular_vectors_of_the_last_merged_block(folders, kept, block):
    model = MergedModel(merging(folders, kept_blocks=kept).parts)
    whole = plain(folders[1]).action_expert.blocks[block]
    for ours, theirs in zip(model.own_value_weights(TASKS[1]), (whole.v_adapter, whole.v_task), strict=True):
        vectors = [torch.linalg.svd(w.detach(), full_matrices=False).Vh[:SUBSPACE] for w in (ours, theirs.weight)]
        assert torch.allclose(*(v.T @ v for v in vectors), atol=1e-5)


def test_leading_keeps_singular_values():
    matrix = torch.randn(12, 10, generator=torch.Generator().manual_seed(0))
    assert torch.allclose(torch.linalg.svdvals(leading(matrix)), torch.linalg.svdvals(matrix)[:SUBSPACE], atol=1e-5)


def test_value_weights_are_those_that_run(folders):
    model = MergedModel(merging(folders).parts)
    values, weights = model.value_weights(TASKS[0]), model.weights(TASKS[0])
    assert len(values) == BLOCKS
    assert torch.equal(values[0][1], weights["action_expert.blocks.0.v_task.weight"])


def test_a_stranger_is_refused(folders):
    model = MergedModel(merging(folders).parts)
    for ask in (model.model, model.weights, model.value_weights, model.own_value_weights):
        with pytest.raises(ExpertsDiffer, match="expected one of the merged experts"):
            ask("stranger")


def test_the_report_tells_masks_from_chance_and_counts_bytes(folders):
    report = merging(folders).report
    assert report.experts == TASKS
    assert set(report.observed.keep) == set(report.null.keep) == set(report.bytes_per_task) == set(TASKS)
    assert len(report.block_distances["action_expert"]) == BLOCKS
    assert min(report.block_distances["action_expert"]) > 0


def test_selected_adapters_count_as_the_tasks_own_bytes(folders):
    merged, selected = (merging(folders, backbone=rule).report.bytes_per_task[TASKS[0]] for rule in BackboneRule)
    assert selected.head > merged.head
    assert selected.mask < merged.mask


def test_nothing_merged_by_vectors_leaves_a_report_too(folders):
    made = merging(folders, backbone="select", trunk="mean")
    assert made.report.entries == 0
    assert not made.parts.merged.masks


def refused(kind, match, *folders, **recipe):
    with pytest.raises(kind, match=match) as caught:
        merging(folders, **recipe)
    assert "\n" not in str(caught.value)


def test_experts_of_different_bases_are_refused(folders, tmp_path):
    stranger = save_expert(tmp_path / "stranger", save_base(tmp_path / "base", seed=9), "null/Raise", 5)
    refused(
        DifferentBases,
        "expected all experts from base .* of null/Reach, got .* for null/Raise",
        *folders[:2],
        stranger,
    )


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
        ({"masks": "tall"}, "expected masks out of none, task, emr, got tall"),
        ({"trunk": "sum"}, "expected trunk out of mean, vectors, got sum"),
        ({"backbone": "half"}, "expected backbone out of merged, select, got half"),
    ],
)
def test_values_out_of_range_are_refused(folders, recipe, match):
    refused(OutOfRange, match, *folders, **recipe)


def test_an_unknown_operator_or_option_is_refused(folders):
    refused(UnknownOperator, "did you mean 'ties'", *folders, operator="tie")
    refused(UnknownOperator, "has no option 'drop'", *folders, options={"drop": 0.5})


def test_lambdas_of_other_experts_are_refused(folders):
    refused(ExpertsDiffer, "expected a lambda for each", *folders, lambda_={"null/Reach": 0.5})


def test_a_rank_out_of_range_is_refused():
    with pytest.raises(PolicyError, match="expected a LoRA rank of 1 or more, got 0"):
        LoraSettings(0)


def test_a_task_without_an_instruction_is_refused(folders, tmp_path):
    unknown = save_expert(tmp_path / "odd", folders[0].parents[1] / "base", "nowhere/Odd", 4)
    with pytest.raises(MergeError, match="expected an instruction for nowhere/Odd"):
        merge_experts(read_experts([unknown]), Recipe(), INSTRUCTIONS)


def test_a_recipe_reads_back_from_json():
    recipe = Recipe("dare", 0.5, "emr", {"a": 0.4}, "mean", 2, True, "select", {"drop": 0.5})
    assert Recipe.from_json(recipe.as_json()) == recipe
    with pytest.raises(MergeError, match="does not read"):
        Recipe.from_json({"operators": "ties"})
