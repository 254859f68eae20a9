"""Merging action experts: a shared trunk, and the last k blocks kept per task (arXiv 2511.18810 section 4.2).

The paper averages trunks that were initialised independently. Trunks that were fine-tuned from one initialisation
have task vectors, so the operators and masks of the backbone apply to them too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from policies.mergevla.merging.elementwise import mean
from policies.mergevla.merging.errors import MergeError, check_range
from policies.mergevla.merging.taus import Weights


class BadPattern(MergeError):
    """The pattern does not find the blocks of these weights."""


@dataclass(frozen=True, eq=False)
class TrunkSplit:
    """The weights of an action expert in two parts."""

    shared: Weights
    """Everything before the last k blocks: to be merged."""
    kept: Weights
    """The last k blocks and the output: one set for each task."""


def block_of(name: str, block_pattern: str) -> int | None:
    r"""Index of the block that a weight belongs to, or None if it is in none.

    Args:
        name: Of the weight.
        block_pattern: Regular expression, matched at the start of the name, whose first group is the block's index,
            such as `blocks\.(\d+)\.`.

    Raises:
        BadPattern: It is no regular expression with such a group.
    """
    try:
        found = re.match(block_pattern, name)
        return int(found.group(1)) if found else None
    except (re.error, IndexError, TypeError, ValueError) as error:
        expected = "expected a pattern whose first group is the block's index"
        raise BadPattern(f"{expected}, got '{block_pattern}' ({error})") from None


def depth_of(names: Mapping[str, object], block_pattern: str) -> int:
    """Number of blocks.

    Raises:
        BadPattern: There are none, or their indices are not 0, 1, 2 and so on.
    """
    indices = {index for name in names if (index := block_of(name, block_pattern)) is not None}
    if not indices or indices != set(range(len(indices))):
        found = ", ".join(map(str, sorted(indices))) or "none"
        raise BadPattern(f"expected blocks 0, 1, 2, ... under the pattern '{block_pattern}', got {found}")
    return len(indices)


def split_trunk(weights: Weights, k: int, *, block_pattern: str, output_pattern: str | None = None) -> TrunkSplit:
    """Take the last k blocks out of an action expert. No tensor is copied.

    Args:
        weights: Of the action expert.
        k: Blocks to keep per task, 0 to all of them.
        block_pattern: See `block_of`.
        output_pattern: Regular expression for what follows the blocks (final LayerNorm, output projection) and stays
            with them whatever k is; None merges it with the trunk.

    Raises:
        OutOfRange: k is not a whole number from 0 to the number of blocks.
        BadPattern: A pattern finds nothing.
    """
    depth = depth_of(weights, block_pattern)
    check_kept_blocks(k, depth)
    try:
        output = {name for name in weights if output_pattern is not None and re.match(output_pattern, name)}
    except re.error as error:
        raise BadPattern(f"expected a regular expression for the output, got '{output_pattern}' ({error})") from None
    if output_pattern is not None and not output:
        raise BadPattern(f"expected weights under the pattern '{output_pattern}' of the output, got none")
    kept: dict[str, torch.Tensor] = {}
    shared: dict[str, torch.Tensor] = {}
    for name, weight in weights.items():
        index = block_of(name, block_pattern)
        own = name in output or (index is not None and index >= depth - k)
        (kept if own else shared)[name] = weight
    return TrunkSplit(shared, kept)


def check_kept_blocks(k: int, depth: int) -> None:
    """Refuse to keep more blocks than there are.

    Raises:
        OutOfRange: k is not a whole number from 0 to `depth`.
    """
    check_range("k, the blocks kept per task,", k, 0, depth, closed="[]", whole=True)


def mean_trunk(trunks: Mapping[str, Weights]) -> dict[str, torch.Tensor]:
    """The uniform mean of the trunks, in fp32: the paper's rule, for trunks of any initialisation.

    Args:
        trunks: Expert name to the shared part of its action expert.

    Raises:
        ExpertsDiffer: Names or shapes differ, or a weight is not finite.
    """
    return mean({expert: {name: w.to(torch.float32) for name, w in trunk.items()} for expert, trunk in trunks.items()})
