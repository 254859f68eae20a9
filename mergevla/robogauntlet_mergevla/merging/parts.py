"""Parts of the network that can be merged by themselves. Light: a recipe is checked without torch."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from robogauntlet.suites.plugins import did_you_mean
from robogauntlet_mergevla.merging.errors import OutOfRange

TRUNK = "trunk"
"""Action queries, proprioception, and the action expert without what each task keeps."""
PREFIXES = {"vision": "backbone.vision.", "projector": "backbone.projector.", "language": "backbone.language."}
"""Part of the backbone to the start of its weights' names."""
BLOCKS = re.compile(r"language\.([0-9]{1,4})(?:-([0-9]{1,4}))?")
"""One block of the language model, `language.2`, or several, `language.0-3`."""
_BLOCK = re.compile(r"backbone\.language\.layers\.(\d+)\.")


def check_parts(parts: Sequence[str]) -> None:
    """Raise OutOfRange for a name that is no part, or blocks in reverse order."""
    for part in parts:
        blocks = BLOCKS.fullmatch(part)
        if part not in (*PREFIXES, TRUNK) and (blocks is None or int(blocks[1]) > int(blocks[2] or blocks[1])):
            raise OutOfRange(
                f"expected a part to merge, {', '.join((*PREFIXES, TRUNK))} or blocks as language.0-3, got '{part}'"
                f"{did_you_mean(part, (*PREFIXES, TRUNK))}"
            )


def is_merged(weight: str, only: Collection[str]) -> bool:
    """Whether a weight belongs to one of the parts that are merged, or any if there are none to choose."""
    if not only:
        return True
    if not weight.startswith("backbone."):
        return TRUNK in only
    if any(weight.startswith(prefix) for part, prefix in PREFIXES.items() if part in only):
        return True
    block = _BLOCK.match(weight)
    ranges = filter(None, map(BLOCKS.fullmatch, only))
    return block is not None and any(int(r[1]) <= int(block[1]) <= int(r[2] or r[1]) for r in ranges)


def check_blocks(only: Collection[str], layers: int) -> None:
    """Raise OutOfRange for blocks that a language model with this number of layers does not have."""
    for part in only:
        if (blocks := BLOCKS.fullmatch(part)) and int(blocks[2] or blocks[1]) >= layers:
            raise OutOfRange(f"expected blocks 0 to {layers - 1} of the language model, got '{part}'")
