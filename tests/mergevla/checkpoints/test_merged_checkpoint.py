"""Saving and loading merged checkpoints, and errors of one line."""

import json
import pickle
import shutil

import pytest
import torch
from safetensors.torch import load_file, save_file

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint
from robogauntlet_mergevla.checkpoints.merge_experts import Merging, merge_experts, read_experts
from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged, save_merged
from robogauntlet_mergevla.checkpoints.merged_metadata import merged_digest_of
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.checkpoints.metadata import METADATA_FILE, WEIGHTS, CheckpointError, digest_of, hash_tensors
from robogauntlet_mergevla.merging.recipe import BackboneRule, MaskRule, Recipe, TrunkRule
from tests.errors import one_line_error
from tests.mergevla.checkpoints.test_expert_checkpoint import Exploding, rewrite
from tests.mergevla.experts import INSTRUCTIONS, TASKS, merging, save_base, save_expert, save_experts

FITTED = {"calibrated/unaided/means": torch.arange(3.0)}


@pytest.fixture(scope="module")
def experts(folders):
    return read_experts(folders)


def merged(experts, **changes):
    return merge_experts(experts, Recipe.from_json(changes), INSTRUCTIONS)


@pytest.fixture(scope="module")
def made(experts):
    return merged(experts)


@pytest.fixture
def saved(made, tmp_path):
    save_merged(tmp_path / "merged", made, FITTED)
    return tmp_path / "merged"


def change(folder, edit):
    """Changes tensors and the hash in the metadata, so that only the tensors show it."""
    tensors = load_file(folder / WEIGHTS)
    edit(tensors)
    save_file(tensors, folder / WEIGHTS)
    rewrite(folder, tensor_hash=hash_tensors(folder / WEIGHTS))


def refused(folder, match):
    with one_line_error(PolicyError, match):
        load_merged(folder)


@pytest.mark.parametrize("trunk", TrunkRule)
@pytest.mark.parametrize("backbone", BackboneRule)
@pytest.mark.parametrize("masks", MaskRule)
def test_a_saved_checkpoint_loads_unchanged(experts, tmp_path, trunk, backbone, masks):
    made = merged(experts, operator="emr", trunk=trunk, backbone=backbone, masks=masks)
    metadata = save_merged(tmp_path, made, FITTED)
    back = load_merged(tmp_path)
    assert back.metadata == metadata
    assert metadata.experts == TASKS
    ours, theirs = MergedModel(made.parts), MergedModel(back.parts)
    for task in (None, *TASKS):
        a, b = ours.weights(task), theirs.weights(task)
        assert all(torch.equal(a[name], b[name]) for name in a)
    assert torch.equal(back.fitted["calibrated/unaided/means"], torch.arange(3.0))
    for task in TASKS:
        pairs = zip(ours.own_value_weights(task), theirs.own_value_weights(task), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs)
    assert theirs.instructions == ours.instructions


@pytest.mark.parametrize("bits", [3, 8])
def test_experts_that_are_not_merged_load_unchanged_and_take_their_bits(experts, tmp_path, bits):
    made = merged(experts, operator="none", masks="none", options={"bits": bits})
    save_merged(tmp_path, made)
    back = load_merged(tmp_path).parts
    ours, theirs = MergedModel(made.parts), MergedModel(back)
    for task in TASKS:
        a, b = ours.weights(task), theirs.weights(task)
        assert all(torch.equal(a[name], b[name]) for name in a)
    entries = sum(matrix.codes.numel() for matrix in made.parts.copies[TASKS[0]].values())
    rows = sum(matrix.scales.numel() for matrix in made.parts.copies[TASKS[0]].values())
    assert made.report.bytes_per_task[TASKS[0]].head == pytest.approx(entries * bits / 8 + 2 * rows, rel=0.01)
    save_merged(tmp_path / "again", Merging(back, made.report, made.base))
    assert hash_tensors(tmp_path / "again" / WEIGHTS) == hash_tensors(tmp_path / WEIGHTS)


@pytest.mark.parametrize(
    "changes",
    [
        {"operator": "ta"},
        {"operator": "ta", "trunk": "mean"},
        {"operator": "emr", "masks": "emr", "kept_blocks": 0, "merge_output": True},
        {"operator": "magnitude", "masks": "signs", "rounds": 2},
        {"operator": "ta", "backbone": "select"},
        {"operator": "ta", "only": ("language",)},
    ],
)
def test_a_merge_at_few_bits_loads_unchanged_and_is_as_large_as_its_bits(experts, tmp_path, changes):
    sizes = {}
    for bits in (3, 4, 8):
        made = merged(experts, bits=bits, **changes)
        save_merged(tmp_path / str(bits), made)
        back = load_merged(tmp_path / str(bits)).parts
        assert back.recipe.as_json()["bits"] == bits
        ours, theirs = MergedModel(made.parts), MergedModel(back)
        for task in TASKS:
            a, b = ours.weights(task), theirs.weights(task)
            assert all(torch.equal(a[name], b[name]) for name in a)
        tensors = load_file(tmp_path / str(bits) / WEIGHTS)
        stored = {name: tensor for name, tensor in tensors.items() if not name.startswith(("mask/", "subspace/"))}
        assert not [name for name in stored if "/codes/" not in name and "scale" not in name and "/mask/" not in name]
        sizes[bits] = sum(tensor.numel() for name, tensor in stored.items() if "/codes/" in name)
    assert [sizes[bits] / sizes[8] for bits in (3, 4)] == pytest.approx([3 / 8, 4 / 8], rel=0.02)


def test_eight_bits_are_near_the_weights_own_types_and_three_are_further(experts):
    exact = MergedModel(merged(experts, operator="ta").parts)

    def distance(bits):
        model = MergedModel(merged(experts, operator="ta", bits=bits).parts)
        pairs = [(model.weights(task), exact.weights(task)) for task in TASKS]
        return sum(float((a[name] - b[name]).square().sum()) for a, b in pairs for name in a)

    assert distance(8) < distance(4) / 10 < distance(3) / 10


@pytest.fixture(scope="module")
def beside_experts(tmp_path_factory):
    """A folder of experts, a checkpoint of them merged, and one that refers to them."""
    folder = tmp_path_factory.mktemp("beside")
    made = merging(save_experts(folder), operator="magnitude", masks=MaskRule.SIGNS, rounds=2)
    save_merged(folder / "whole", made, FITTED)
    save_merged(folder / "merged", made, FITTED, weights=False)
    return folder


@pytest.fixture
def without_weights(beside_experts, tmp_path):
    """A merged checkpoint beside its experts, which it refers to."""
    shutil.copytree(beside_experts, tmp_path, dirs_exist_ok=True)
    return tmp_path / "merged"


def test_a_model_merged_at_loading_is_the_stored_one(without_weights):
    whole = without_weights.parent / "whole"
    assert merged_digest_of(str(without_weights)) == merged_digest_of(str(whole))
    (first, one), (second, other) = (
        (checkpoint, MergedModel(checkpoint.parts)) for checkpoint in map(load_merged, (whole, without_weights))
    )
    for expert in TASKS:
        a, b = one.weights(expert), other.weights(expert)
        assert all(torch.equal(a[name], b[name]) for name in a)
        assert all(map(torch.equal, one.own_value_weights(expert), other.own_value_weights(expert)))
    assert second.fitted.keys() == first.fitted.keys() == FITTED.keys()
    assert {name.partition("/")[0] for name in load_file(without_weights / WEIGHTS)} == {"router", "subspace"}


def test_a_model_merged_at_loading_moves_with_its_experts(without_weights, tmp_path):
    digest = merged_digest_of(str(without_weights))
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for name in ("base", "experts", "merged"):
        (tmp_path / name).rename(moved / name)
    assert merged_digest_of(str(moved / "merged")) == digest
    assert load_merged(moved / "merged").parts.statistics.tasks == TASKS


def test_another_expert_in_the_place_of_a_merged_one_is_refused(without_weights, tmp_path):
    save_expert(tmp_path / "experts" / "null-Slow", tmp_path / "base", "null/Slow", seed=9)
    refused(without_weights, "expected expert null/Slow of digest [0-9a-f]{16}, got [0-9a-f]{16}")


def test_the_message_for_a_missing_expert_of_a_merged_model_names_both(without_weights, tmp_path):
    (tmp_path / "experts" / "null-Slow").rename(tmp_path / "moved")
    refused(without_weights, f"'{without_weights}': expected its expert null/Slow at '../experts/null-Slow'")


def test_merged_weights_beside_references_to_experts_are_refused(without_weights):
    change(without_weights, lambda tensors: tensors.update({"tau/x": torch.zeros(2)}))
    refused(without_weights, "expected the tensors of a merged model, got tau")


def test_a_merged_model_without_an_experts_value_projections_is_refused_before_it_is_merged(without_weights):
    change(without_weights, lambda tensors: [tensors.pop(name) for name in sorted(tensors) if "subspace/1/" in name])
    refused(without_weights, f"'{without_weights}': expected the value projections of expert 1")


@pytest.mark.parametrize("changes", [{"checkpoints": {}}, {"merged_hash": ""}])
def test_references_without_the_hash_of_the_merged_weights_are_refused(without_weights, changes):
    rewrite(without_weights, **changes)
    refused(without_weights, "expected checkpoints and merged_hash together")


def test_metadata_that_are_not_those_of_the_experts_are_refused_when_they_are_merged(without_weights):
    rewrite(without_weights, action_steps={"null/Slow": 2})
    with one_line_error(PolicyError, f"'{without_weights}': expected the action steps of its experts"):
        assert load_merged(without_weights).parts


def test_references_to_some_of_the_experts_are_refused(without_weights):
    rewrite(without_weights, checkpoints={"null/Slow": "../experts/null-Slow"})
    refused(without_weights, "expected statistics and the checkpoint of each merged expert")


@pytest.fixture(scope="module")
def with_copies(experts, tmp_path_factory):
    """A checkpoint of experts that are not merged and take fewer bits."""
    folder = tmp_path_factory.mktemp("copies")
    save_merged(folder, merged(experts, operator="none", masks="none", options={"bits": 4}))
    return folder


def stray(tensors):
    tensors["copy/1/codes/stray"] = torch.zeros(2, dtype=torch.uint8)


@pytest.mark.parametrize(
    ("edit", "match"),
    [
        (stray, "expected weights of the base, or both factors of one, got stray"),
        (
            lambda t: [t.pop(n) for n in sorted(t) if n.startswith("copy/1/codes/") and n.endswith("/b")],
            "expected both",
        ),
        (lambda t: [t.pop(n) for n in sorted(t) if n.startswith("copy/1/codes/") and n.endswith("/a")], "both factors"),
        (lambda t: [t.pop(n) for n in sorted(t) if n.startswith("copy/1/scales/")], "got no scales"),
        (lambda t: [t.pop(n) for n in sorted(t) if n.startswith("copy/1/")], "to be merged or kept, it is neither"),
    ],
)
def test_damaged_copies_are_one_line(with_copies, tmp_path, edit, match):
    shutil.copytree(with_copies, tmp_path, dirs_exist_ok=True)
    change(tmp_path, edit)
    refused(tmp_path, match)


def test_the_metadata_hold_recipe_report_and_expert_digests(saved, made):
    metadata = load_merged(saved).metadata
    assert metadata.recipe == made.parts.recipe
    assert metadata.report == json.loads(made.report.to_json())
    assert set(metadata.expert_digests) == set(TASKS)


def test_masks_take_a_bit_for_each_entry(saved):
    tensors = load_file(saved / WEIGHTS)
    vector = {name.removeprefix("tau/"): tensor for name, tensor in tensors.items() if name.startswith("tau/")}
    bits = {name: len(tensors[f"mask/0/bits/{name}"]) for name in vector}
    assert bits == {name: -(-tensor.numel() // 8) for name, tensor in vector.items()}


def test_the_digest_is_of_the_content(saved, experts, tmp_path):
    save_merged(tmp_path / "same", merged(experts), FITTED)
    save_merged(tmp_path / "other", merged(experts, lambda_=0.5), FITTED)
    save_merged(tmp_path / "unfitted", merged(experts))
    names = (saved, tmp_path / "same", tmp_path / "other", tmp_path / "unfitted")
    digests = [merged_digest_of(str(name)) for name in names]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 3


@pytest.mark.parametrize("keep", [0, 4, 200, -1])
def test_a_truncated_file_is_refused(saved, keep):
    data = (saved / WEIGHTS).read_bytes()
    (saved / WEIGHTS).write_bytes(data[:keep])
    refused(saved, "truncated")


def test_a_changed_tensor_is_refused(saved):
    data = bytearray((saved / WEIGHTS).read_bytes())
    data[-1] ^= 1
    (saved / WEIGHTS).write_bytes(data)
    refused(saved, "expected tensors of hash")
    with pytest.raises(CheckpointError, match="expected tensors of hash"):
        merged_digest_of(str(saved))


def test_a_pickle_is_refused_and_never_opened(saved, tmp_path):
    (saved / WEIGHTS).write_bytes(pickle.dumps(Exploding()))
    refused(saved, "another format")
    (tmp_path / "p").mkdir()
    (tmp_path / "p" / "model.pt").write_bytes(pickle.dumps(Exploding()))
    refused(tmp_path / "p", "got model.pt, a pickle: refused")


def test_nan_is_neither_saved_nor_loaded(saved, experts, tmp_path):
    made = merged(experts)
    next(iter(made.parts.merged.vector.values())).fill_(torch.nan)
    with pytest.raises(CheckpointError, match="NaN or infinity in tau/"):
        save_merged(tmp_path / "nan", made)
    change(saved, lambda tensors: tensors["head/1/action_expert.output.bias"].fill_(torch.nan))
    refused(saved, "NaN or infinity in head/1/action_expert.output.bias")


def test_a_mask_for_another_model_is_refused(saved):
    name = "backbone.projector.0.weight"
    change(saved, lambda tensors: tensors.update({f"mask/1/shape/{name}": torch.tensor([8, 32])}))
    refused(saved, rf"the mask is for another model: weight {name}: expected shape \(16, 16\), got \(8, 32\)")
    change(saved, lambda tensors: [tensors.pop(f"mask/1/{part}/{name}") for part in ("bits", "shape")])
    refused(saved, f"the mask is for another model: weight {name} is missing")


def test_row_scales_for_another_model_are_refused(experts, tmp_path):
    save_merged(tmp_path, merged(experts, operator="magnitude", masks=MaskRule.SIGNS), FITTED)
    name = "backbone.projector.0.weight"
    change(tmp_path, lambda tensors: tensors.update({f"scale/1/{name}": torch.ones(8)}))
    refused(tmp_path, rf"row scales are for another model: weight {name}: expected shape \(16,\), got \(8,\)")
    change(tmp_path, lambda tensors: tensors.pop(f"scale/1/{name}"))
    refused(tmp_path, f"row scales are for another model: weight {name} is missing")


def test_all_rounds_are_loaded(experts, tmp_path):
    made = merged(experts, operator="magnitude", masks=MaskRule.SIGNS, rounds=2)
    save_merged(tmp_path, made, FITTED)
    ours, theirs = MergedModel(made.parts), MergedModel(load_merged(tmp_path).parts)
    for task in TASKS:
        a, b = ours.weights(task), theirs.weights(task)
        assert all(torch.equal(a[name], b[name]) for name in a)
    once = MergedModel(merged(experts, operator="magnitude", masks=MaskRule.SIGNS).parts).weights(TASKS[0])
    twice = theirs.weights(TASKS[0])
    assert any(not torch.equal(once[name], twice[name]) for name in once)
    assert made.report.bytes_per_task[TASKS[0]].mask > 2 * made.report.entries // 8


def test_a_second_round_for_another_model_is_refused(experts, tmp_path):
    save_merged(tmp_path, merged(experts, operator="magnitude", masks=MaskRule.SIGNS, rounds=2), FITTED)
    name = "backbone.projector.0.weight"
    change(tmp_path, lambda tensors: [tensors.pop(k) for k in list(tensors) if k.startswith("residual/") and name in k])
    refused(tmp_path, f"the second round is for another model: weight {name} is missing")


def test_a_missing_head_is_refused(saved):
    change(saved, lambda tensors: tensors.pop("head/1/action_expert.output.bias"))
    refused(saved, "expert null/Slow: expected action_expert.output.bias to be merged or kept, it is neither")


def test_a_weight_of_another_shape_is_refused(saved):
    change(saved, lambda tensors: tensors.update({"head/1/action_expert.output.bias": torch.zeros(6)}))
    refused(saved, r"weight action_expert.output.bias: expected shape \(7,\), got \(6,\)")


def test_missing_statistics_are_refused(saved):
    rewrite(saved, statistics=None)
    refused(saved, "expected normalisation statistics of each merged expert")


@pytest.mark.parametrize("rescalers", [{}, {"null/Reach": 1.0}, dict.fromkeys(TASKS, "1")])
def test_missing_rescalers_are_refused(experts, tmp_path, rescalers):
    save_merged(tmp_path, merged(experts, operator="emr", masks="emr"))
    rewrite(tmp_path, rescalers=rescalers)
    refused(tmp_path, "expected a rescaler of each merged expert|rescalers.*: expected a valid number, got '1'")


def test_a_recipe_out_of_range_is_refused(saved):
    recipe = json.loads((saved / METADATA_FILE).read_text())["recipe"]
    rewrite(saved, recipe={**recipe, "lambda_": 7})
    refused(saved, "expected lambda")


def test_another_base_in_the_bases_place_is_refused(tmp_path):
    made = merging(save_experts(tmp_path))
    save_merged(tmp_path / "merged", made)
    save_base(tmp_path / "base", seed=5)
    refused(tmp_path / "merged", "expected tensors of hash")


def test_a_plain_checkpoint_is_no_merged_one_and_the_reverse(saved, folders):
    refused(folders[0], "expected a merged checkpoint, got a checkpoint of one network")
    for use in (load_checkpoint, digest_of):
        with one_line_error(CheckpointError, "expected a checkpoint of one network, got a merged checkpoint"):
            use(str(saved))


def test_merged_checkpoint_and_base_can_move_together(tmp_path):
    save_merged(tmp_path / "zoo" / "merged", merging(save_experts(tmp_path / "zoo")))
    before = merged_digest_of(str(tmp_path / "zoo" / "merged"))
    (tmp_path / "zoo").rename(tmp_path / "moved")
    assert merged_digest_of(str(tmp_path / "moved" / "merged")) == before
    assert load_merged(tmp_path / "moved" / "merged").metadata.base == "../base"
