"""Splitting, averaging and merging action experts."""

import pytest
import torch

from policies.mergevla.merging.errors import OutOfRange
from policies.mergevla.merging.merged import merge
from policies.mergevla.merging.taus import task_vector
from policies.mergevla.merging.trunk import (
    BadPattern,
    depth_of,
    mean_trunk,
    split_trunk,
)
from tests.policies.mergevla.merging.strategies import close, equal

BLOCKS, OUTPUT, DEPTH = r"blocks\.(\d+)\.", "final_", 12


def action_expert(seed):
    generator = torch.Generator().manual_seed(seed)
    names = ["input.weight", *(f"blocks.{i}.{part}" for i in range(DEPTH) for part in ("weight", "gate"))]
    names += ["final_norm.weight", "final_output.weight"]
    return {name: torch.randn((3, 3) if name.endswith("weight") else (), generator=generator) for name in names}


def split(weights, k, output=OUTPUT):
    return split_trunk(weights, k, block_pattern=BLOCKS, output_pattern=output)


@pytest.mark.parametrize("k", range(DEPTH + 1))
def test_a_split_keeps_the_last_k_blocks_and_the_output_and_joins_to_the_whole(k):
    whole = action_expert(0)
    parts = split(whole, k)
    last = {f"blocks.{i}.{part}" for i in range(DEPTH - k, DEPTH) for part in ("weight", "gate")}
    assert parts.kept.keys() == last | {"final_norm.weight", "final_output.weight"}
    assert not parts.shared.keys() & parts.kept.keys()
    assert equal({**parts.shared, **parts.kept}, whole)


def test_without_an_output_pattern_k_0_keeps_nothing():
    parts = split(action_expert(0), 0, output=None)
    assert not parts.kept
    assert "final_output.weight" in parts.shared


@pytest.mark.parametrize("k", [-1, DEPTH + 1, 1.0, True, "1"])
def test_a_k_out_of_range_is_refused(k):
    with pytest.raises(OutOfRange, match=r"expected k.* in \[0, 12\], got"):
        split(action_expert(0), k)


@pytest.mark.parametrize("pattern", ["layers\\.(\\d+)\\.", "blocks", "blocks\\.(", "(blocks)"])
def test_a_pattern_that_does_not_find_the_blocks_is_refused(pattern):
    with pytest.raises(BadPattern):
        depth_of(action_expert(0), pattern)


def test_an_output_pattern_that_finds_nothing_is_refused():
    with pytest.raises(BadPattern, match="'head' of the output, got none"):
        split(action_expert(0), 1, output="head")


def test_missing_blocks_are_noticed():
    whole = action_expert(0)
    with pytest.raises(BadPattern, match=r"expected blocks 0, 1, 2, .* got 0, 1, 2, 4"):
        depth_of({name: w for name, w in whole.items() if not name.startswith("blocks.3.")}, BLOCKS)


def test_the_mean_trunk_is_the_mean_in_fp32():
    trunks = {"a": {"w": torch.tensor([1.0, 2.0]).bfloat16()}, "b": {"w": torch.tensor([2.0, 4.0])}}
    merged = mean_trunk(trunks)["w"]
    assert merged.dtype == torch.float32
    assert merged.tolist() == [1.5, 3.0]


def test_trunks_from_one_initialisation_merge_by_task_vectors_and_masks():
    base = action_expert(0)
    tuned = {
        "a": {**base, "blocks.0.weight": base["blocks.0.weight"] + torch.eye(3)},
        "b": {**base, "blocks.1.weight": base["blocks.1.weight"] + torch.eye(3)},
    }
    trunks = {expert: split(weights, 1).shared for expert, weights in tuned.items()}
    start = split(base, 1).shared
    merged = merge({expert: task_vector(trunk, start) for expert, trunk in trunks.items()})
    # The two changed different weights, so the masks separate them entirely; a mean would halve both changes.
    for expert, weights in tuned.items():
        whole = {**merged.weights(start, expert), **split(weights, 1).kept}
        assert close(whole, weights)
