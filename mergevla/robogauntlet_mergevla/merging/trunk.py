"""Merging action experts: a shared trunk, and the last k blocks kept per task (arXiv 2511.18810 section 4.2).

The paper averages trunks that were initialised independently. Trunks that were fine-tuned from one initialisation
have task vectors, so the operators and masks of the backbone apply to them too.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import torch

from robogauntlet_mergevla.merging.elementwise import mean
from robogauntlet_mergevla.merging.errors import check_range
from robogauntlet_mergevla.merging.task_vectors import Weights, check_task_vectors

BLOCKS = re.compile(r"action_expert\.blocks\.(\d+)\.")
OUTPUT = "action_expert.output"
"""The action expert's last LayerNorm and its output projection, not a block's own output projection."""


def block_of(name: str) -> int | None:
    """Index of the block that a weight belongs to, or None if it is in none."""
    match = BLOCKS.match(name)
    return int(match[1]) if match else None


def depth_of(names: Iterable[str]) -> int:
    """Number of blocks."""
    return 1 + max((index for name in names if (index := block_of(name)) is not None), default=-1)


def split_trunk(weights: Weights, k: int, *, merge_output: bool = False) -> tuple[Weights, Weights]:
    """Split weights into the trunk, which is merged, and the last k blocks and the output, which each task keeps.

    Args:
        weights: Weights of the action expert, action queries and proprioception. No tensor is copied.
        k: Number of blocks to keep per task, from 0 to all of them; OutOfRange otherwise.
        merge_output: Whether the output layer belongs to the trunk; otherwise each task keeps it, for any k.
    """
    depth = depth_of(weights)
    check_kept_blocks(k, depth)
    kept: dict[str, torch.Tensor] = {}
    shared: dict[str, torch.Tensor] = {}
    for name, weight in weights.items():
        index = block_of(name)
        is_own = index >= depth - k if index is not None else name.startswith(OUTPUT) and not merge_output
        (kept if is_own else shared)[name] = weight
    return shared, kept


def check_kept_blocks(k: int, depth: int) -> None:
    """Raise OutOfRange unless k is a whole number from 0 to `depth`."""
    check_range("k, the blocks kept per task,", k, 0, depth, closed="[]", whole=True)


def mean_trunk(trunks: Mapping[str, Weights]) -> dict[str, torch.Tensor]:
    """Return the uniform mean of the trunks (expert name to weights), in fp32: the paper's rule for any initialisation.

    Raises ExpertsDiffer if names or shapes differ, or a weight is not finite.
    """
    converted = {expert: {name: w.to(torch.float32) for name, w in trunk.items()} for expert, trunk in trunks.items()}
    check_task_vectors(converted)
    return mean(converted)
