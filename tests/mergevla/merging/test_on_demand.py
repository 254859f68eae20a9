"""Tensors that are made when they are asked for, and merges of weights that are not of fp32."""

from functools import partial

import pytest
import torch

from robogauntlet_mergevla.checkpoints.merged_checkpoint import load_merged, save_merged
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.merging import diagnostics, elementwise
from robogauntlet_mergevla.merging.task_vectors import OnDemand
from tests.mergevla.experts import TASKS, merging, save_base, save_expert


def test_a_tensor_is_made_once_for_each_time_that_another_was_asked_for_before():
    made = []

    def make(name):
        made.append(name)
        return torch.ones(1)

    tensors = OnDemand({name: partial(make, name) for name in "ab"})
    assert list(tensors) == ["a", "b"]
    assert "a" in tensors
    assert made == []
    assert tensors["a"] is tensors["a"]
    assert len(list(tensors.items())) == len(tensors) == 2
    assert tensors["a"].shape == (1,)
    assert made == ["a", "b", "a"]


def half(folder):
    """A base in bf16 and three experts of it."""
    base = save_base(folder / "base", dtype=torch.bfloat16)
    return [save_expert(folder / str(seed), base, task, seed) for seed, task in enumerate(TASKS)]


def test_a_merge_on_a_base_in_half_precision_is_stored_in_it_and_read_back_the_same(tmp_path):
    folders = half(tmp_path)
    for trunk in ("vectors", "mean"):
        made = merging(folders, trunk=trunk)
        save_merged(tmp_path / trunk, made)
        loaded = load_merged(tmp_path / trunk).parts
        assert {tensor.dtype for tensor in (*loaded.merged.vector.values(), *loaded.trunk.values())} == {torch.bfloat16}
        for task in TASKS:
            before, after = MergedModel(made.parts).weights(task), MergedModel(loaded).weights(task)
            assert all(torch.equal(before[name], after[name]) for name in before)
            assert {tensor.dtype for tensor in after.values()} == {torch.bfloat16}


def test_the_null_of_many_weights_is_computed_from_some_of_them(tmp_path, monkeypatch):
    folders = half(tmp_path)
    whole = merging(folders).report
    monkeypatch.setattr(diagnostics, "NULL_ENTRIES", whole.entries // 2)
    drawn = merging(folders).report
    assert drawn.observed == whole.observed
    assert drawn.null != whole.null
    assert abs(drawn.null.selfish - whole.null.selfish) < 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_signs_are_elected_the_same_in_blocks_of_any_size(monkeypatch, sign):
    generator = torch.Generator().manual_seed(0)
    experts = {name: {"w": torch.randn(5, 7, generator=generator) + sign} for name in "abc"}
    experts["b"]["w"][0], experts["c"]["w"][0] = -experts["a"]["w"][0], 0.0
    whole = elementwise.ties(experts)["w"]
    assert torch.equal(whole[0].sign(), torch.full((7,), sign))
    monkeypatch.setattr(elementwise, "BLOCK", 3)
    assert torch.equal(elementwise.ties(experts)["w"], whole)
