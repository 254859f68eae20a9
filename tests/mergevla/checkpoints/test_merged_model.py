"""The merged model: the origin of every weight, and the inputs of routers."""

import itertools

import pytest
import torch

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.checkpoints.merged_model import SUBSPACE, MergedModel, leading
from robogauntlet_mergevla.merging.errors import ExpertsDiffer
from robogauntlet_mergevla.merging.recipe import BackboneRule, MaskRule, Recipe, TrunkRule
from tests.mergevla.experts import TASKS, merging, plain
from tests.mergevla.shared import SMALL, inputs, small_model

BLOCKS = SMALL.language.layers


def same(ours, theirs, tolerance=1e-6):
    return ours.keys() == theirs.keys() and all(torch.allclose(ours[n], theirs[n], atol=tolerance) for n in ours)


@pytest.mark.parametrize("trunk", TrunkRule)
@pytest.mark.parametrize("backbone", BackboneRule)
@pytest.mark.parametrize("masks", [MaskRule.NONE, MaskRule.TASK])
def test_a_single_expert_is_unchanged_by_merging(folders, trunk, backbone, masks):
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
    assert all(name.startswith("backbone.") for name in parts.merged.vector)
    name = "action_expert.blocks.0.k_task.weight"
    mean = torch.stack([plain(folder).state_dict()[name] for folder in folders]).mean(0)
    assert torch.allclose(MergedModel(parts).weights(TASKS[1])[name], mean, atol=1e-7)


def test_trunk_vectors_are_masked_as_the_backbone_is(folders):
    parts = merging(folders, operator="ta").parts
    name = "action_expert.blocks.0.k_task.weight"
    base = parts.base[name]
    task_vectors = [plain(folder).state_dict()[name] - base for folder in folders]
    merged = sum(task_vectors)
    expected = base + merged * (task_vectors[2].abs() > 0.6 * (merged - task_vectors[2]).abs())
    assert torch.allclose(MergedModel(parts).weights(TASKS[2])[name], expected, atol=1e-6)


def test_networks_run_with_the_weights_of_their_expert(folders):
    model = MergedModel(merging(folders).parts)
    assert model.experts == TASKS
    for name in (None, *TASKS):
        assert same(dict(model.model(name).state_dict()), model.weights(name), 0)
    assert torch.equal(model.model(None)(*inputs(SMALL)), small_model()(*inputs(SMALL)))


def test_a_network_is_built_once(folders):
    model = MergedModel(merging(folders).parts)
    first = model.model(TASKS[0])
    for task in TASKS[1:]:
        model.model(task)
    assert model.model(TASKS[0]) is first


def test_without_merging_each_task_has_its_expert_to_the_precision_of_its_bits(folders):
    def distance(bits):
        parts = merging(folders, operator="none", masks="none", options={"bits": bits}).parts
        weights = MergedModel(parts).weights(TASKS[1])
        own, base = plain(folders[1]).state_dict(), parts.base
        error = sum((weights[name] - own[name]).square().sum() for name in own)
        return float((error / sum((own[name] - base[name]).square().sum() for name in own)).sqrt())

    distances = [distance(bits) for bits in (2, 4, 6, 8)]
    assert distances == sorted(distances, reverse=True)
    assert distances[1] < 0.2
    assert distances[-1] < 0.01


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


def test_projections_are_those_that_run(folders):
    model = MergedModel(merging(folders).parts)
    weights = model.weights(TASKS[0])
    for block in range(BLOCKS):
        found = model.projections(TASKS[0], block)
        assert found.keys() == {"k_adapter", "k_task", "v_adapter", "v_task"}
        for name, weight in found.items():
            assert torch.equal(weight, weights[f"action_expert.blocks.{block}.{name}.weight"])


def test_an_unknown_expert_is_refused(folders):
    model = MergedModel(merging(folders).parts)
    for ask in (model.model, model.weights, model.own_value_weights, lambda expert: model.projections(expert, 0)):
        with pytest.raises(ExpertsDiffer, match="expected one of the merged experts"):
            ask("unknown")
