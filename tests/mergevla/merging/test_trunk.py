"""Splitting, averaging and merging action experts."""

import pytest
import torch

from robogauntlet_mergevla.merging.errors import OutOfRange
from robogauntlet_mergevla.merging.merge import merge
from robogauntlet_mergevla.merging.recipe import Recipe
from robogauntlet_mergevla.merging.task_vectors import task_vector
from robogauntlet_mergevla.merging.trunk import mean_trunk, split_trunk
from tests.mergevla.merging.strategies import close, equal

DEPTH = 12


def action_expert(seed):
    generator = torch.Generator().manual_seed(seed)
    names = ["input.weight", *(f"blocks.{i}.{part}" for i in range(DEPTH) for part in ("weight", "gate"))]
    names = [f"action_expert.{name}" for name in (*names, "output_norm.weight", "output.weight")]
    return {name: torch.randn((3, 3) if name.endswith("weight") else (), generator=generator) for name in names}


@pytest.mark.parametrize("k", range(DEPTH + 1))
def test_a_split_keeps_the_last_k_blocks_and_the_output_and_joins_to_the_whole(k):
    whole = action_expert(0)
    shared, kept = split_trunk(whole, k)
    last = {f"action_expert.blocks.{i}.{part}" for i in range(DEPTH - k, DEPTH) for part in ("weight", "gate")}
    assert kept.keys() == last | {"action_expert.output_norm.weight", "action_expert.output.weight"}
    assert not shared.keys() & kept.keys()
    assert equal({**shared, **kept}, whole)


def test_with_the_output_merged_k_0_keeps_nothing():
    shared, kept = split_trunk(action_expert(0), 0, merge_output=True)
    assert not kept
    assert "action_expert.output.weight" in shared


@pytest.mark.parametrize("k", [-1, DEPTH + 1, 1.0, True, "1"])
def test_a_k_out_of_range_is_refused(k):
    with pytest.raises(OutOfRange, match=r"expected k.* in \[0, 12\], got"):
        split_trunk(action_expert(0), k)


def test_the_mean_trunk_is_the_mean_in_fp32():
    trunks = {"a": {"w": torch.tensor([1.0, 2.0]).bfloat16()}, "b": {"w": torch.tensor([2.0, 4.0])}}
    merged = mean_trunk(trunks)["w"]
    assert merged.dtype == torch.float32
    assert merged.tolist() == [1.5, 3.0]


def test_trunks_from_one_initialisation_merge_by_task_vectors_and_masks():
    base = action_expert(0)
    tuned = {
        "a": {**base, "action_expert.blocks.0.weight": base["action_expert.blocks.0.weight"] + torch.eye(3)},
        "b": {**base, "action_expert.blocks.1.weight": base["action_expert.blocks.1.weight"] + torch.eye(3)},
    }
    trunks = {expert: split_trunk(weights, 1)[0] for expert, weights in tuned.items()}
    start, _ = split_trunk(base, 1)
    merged = merge({expert: task_vector(trunk, start) for expert, trunk in trunks.items()}, Recipe("ta"))
    # The two changed different weights, so the masks separate them entirely; a mean would halve both changes.
    for expert, weights in tuned.items():
        deltas = merged.of(expert)
        whole = {name: weight + deltas[name] for name, weight in start.items()} | dict(split_trunk(weights, 1)[1])
        assert close(whole, weights)
