"""Makes a checkpoint of ours from a released one: every weight by name, none left out and none invented."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from pathlib import Path

import torch
from torch import Tensor

from robogauntlet.adapters.contract import ACTION_NAMES, GRIPPER
from robogauntlet.support.text import counted
from robogauntlet_mergevla.checkpoints.expert_checkpoint import check_finite, write_folder
from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
from robogauntlet_mergevla.network.config import QWEN, Architecture, PaperCodeQuirks, Towers
from robogauntlet_mergevla.network.lora import BACKBONE
from robogauntlet_mergevla.network.model import empty, trunk
from robogauntlet_mergevla.network.normalisation import Quantiles, Statistics, TaskStatistics
from robogauntlet_mergevla.released.files import STATISTICS, ReleasedError, read_files
from robogauntlet_mergevla.released.names import (
    DINOV2_POSITIONS,
    FINAL,
    UNUSED,
    Kind,
    Layout,
    Source,
    source_of,
)

SHOWN = 3
"""Names in a message."""
DTYPES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
"""Types of weights; smaller ones are quantised."""
UNIT = TaskStatistics({"prismatic": Statistics(*(Quantiles((-1.0,) * n, (1.0,) * n) for n in (7, 8)))})
"""Statistics of a base that no data were seen with: nothing is normalised."""


@dataclass(frozen=True, eq=False)
class Imported:
    """A released checkpoint as ours, not yet written."""

    tensors: Mapping[str, Tensor]
    """By their names in our network."""
    metadata: CheckpointMetadata


def import_released(
    kind: Kind, places: Sequence[Path], *, seed: int = 0, tokenizer: str | None = None, size: Architecture = QWEN
) -> Imported:
    """Read a released checkpoint; nothing is written.

    The network is the released one with its errors (`PaperCodeQuirks`), so that it computes the same, except for the
    last number of an action: released policies give 1 for open and 0 for closed, ours -1 and +1, and the output layer
    of the import makes one of the other. A Prismatic model becomes a base: its trunk is new.

    Args:
        kind: What was released.
        places: Its files, or folders of them.
        seed: Seed of the trunk of a Prismatic model.
        tokenizer: See `Architecture.tokenizer`; by default that of `size`.
        size: Sizes of the network.

    Raises:
        ReleasedError: Tensors are missing, are others, or are of another shape; or statistics are missing.
    """
    files = read_files(places)
    used = {name: tensor for name, tensor in files.tensors.items() if not UNUSED.match(name)}
    _check_adapters(used)
    architecture = architecture_of(kind, used, replace(size, tokenizer=tokenizer or size.tokenizer))
    sources = sources_of(kind, architecture)
    _check_names(kind, used, architecture)
    shapes = _shapes(architecture)
    for ours, source in sources.items():
        expected = released_shape(shapes[ours], source.layout)
        if source.name and used[source.name].shape != expected:
            given = tuple(used[source.name].shape)
            raise ReleasedError(
                f"expected {source.name} of shape {tuple(expected)}, as in '{architecture.name}', got {given}"
            )
    if (other := next((name for name, t in used.items() if not _is_plain(t)), None)) is not None:
        raise ReleasedError(f"expected numbers with a fraction in {other}, got {used[other].dtype}; quantised?")
    if files.statistics is None and kind is not Kind.PRISMATIC:
        raise ReleasedError(f"expected {STATISTICS} of the data that the policy was trained on, got none; add the file")
    dtype = reduce(torch.promote_types, {tensor.dtype for tensor in used.values()})
    tensors = {
        ours: converted(used[source.name] if source.name else torch.zeros(shapes[ours]), source).to(dtype)
        for ours, source in sources.items()
    }
    if kind is Kind.PRISMATIC:
        tensors |= {name: weight.to(dtype) for name, weight in trunk(architecture, seed).items()}
    metrics = {"seed": seed} if kind is Kind.PRISMATIC else {}
    return Imported(tensors, CheckpointMetadata(architecture, files.statistics or UNIT, metrics=metrics))


def _is_plain(tensor: Tensor) -> bool:
    """Whether it holds numbers that can be computed with, in memory and not sparse."""
    return tensor.dtype in DTYPES and tensor.layout is torch.strided and tensor.device.type == "cpu"


def save_imported(imported: Imported, folder: Path) -> CheckpointMetadata:
    """Write an imported checkpoint. Raises CheckpointError for NaN or infinite weights, OSError if it cannot write."""
    check_finite(imported.tensors, folder)
    folder.mkdir(parents=True, exist_ok=True)
    return write_folder(folder, imported.tensors, imported.metadata)


def architecture_of(kind: Kind, tensors: Mapping[str, Tensor], size: Architecture = QWEN) -> Architecture:
    """Return the architecture of a released checkpoint, whose DINOv2 may have positions of 224 or of 518 px."""
    vision, expert = size.vision, replace(size.expert, self_attention=kind is Kind.VLA_ADAPTER)
    assert isinstance(vision, Towers)
    positions = tensors.get(DINOV2_POSITIONS)
    side = math.isqrt(positions.shape[1]) if positions is not None and positions.ndim == 3 else 0
    dinov2 = replace(vision.dinov2, image_size=vision.dinov2.patch_size * side) if side else vision.dinov2
    return replace(
        size,
        name=size.name if kind is not Kind.VLA_ADAPTER else f"{size.name}-self-attention",
        vision=replace(vision, dinov2=dinov2, exact_gelu=True),
        expert=expert,
        # Prismatic's own order of the sequence is all that it shares with the released action experts.
        quirks=PaperCodeQuirks(language_blind=True) if kind is Kind.PRISMATIC else PaperCodeQuirks.paper(),
    )


def sources_of(kind: Kind, architecture: Architecture) -> dict[str, Source]:
    """Return where each of our tensors is in a released checkpoint; for a Prismatic model, those of the backbone."""
    names = _shapes(architecture)
    return {ours: source_of(ours, kind) for ours in names if kind is not Kind.PRISMATIC or ours.startswith(BACKBONE)}


@lru_cache(maxsize=8)
def _shapes(architecture: Architecture) -> Mapping[str, torch.Size]:
    """The shape of each of our tensors, for which a network is made that may have seven hundred of them."""
    return {ours: tensor.shape for ours, tensor in empty(architecture).state_dict().items()}


def released_shape(ours: torch.Size, layout: Layout) -> torch.Size:
    """Return the shape of the released tensor that one of ours is made from."""
    if layout in (Layout.QUERY, Layout.KEY, Layout.VALUE):
        return torch.Size((3 * ours[0], *ours[1:]))
    if layout is Layout.PATCHES:
        return torch.Size((1, ours[1] - 1, ours[2]))
    return torch.Size((1, *ours)) if layout is Layout.BATCHED else ours


def converted(released: Tensor, source: Source) -> Tensor:
    """Return our tensor made from a released one."""
    match source.layout:
        case Layout.QUERY | Layout.KEY | Layout.VALUE:
            third = (Layout.QUERY, Layout.KEY, Layout.VALUE).index(source.layout)
            return released.chunk(3)[third].clone()
        case Layout.PATCHES:
            return torch.cat([torch.zeros_like(released[:, :1]), released], dim=1)
        case Layout.BATCHED:
            return released[0].clone()
    if source.name not in FINAL:
        return released.contiguous()
    changed, gripper = released.clone(), ACTION_NAMES.index(GRIPPER)
    changed[gripper] = -2 * released[gripper].float() + (1.0 if source.name == FINAL[1] else 0.0)
    return changed


def _check_adapters(tensors: Mapping[str, Tensor]) -> None:
    if name := next((name for name in tensors if ".lora_" in name), None):
        raise ReleasedError(
            f"expected weights with their LoRA adapters merged, got {name}; merge them first (peft: merge_and_unload)"
        )


def _check_names(kind: Kind, given: Mapping[str, Tensor], architecture: Architecture) -> None:
    expected = _names(kind, architecture)
    if expected == given.keys():
        return
    missing, unexpected = sorted(expected - given.keys()), sorted(given.keys() - expected)
    count = counted(len(expected), "tensor")
    for other in Kind:
        if other is not kind and _names(other, architecture_of(other, given, architecture)) == given.keys():
            raise ReleasedError(f"expected the {count} of '{kind}', got those of '{other}'; import them as that")
    if missing:
        verb = "is" if len(missing) == 1 else "are"
        raise ReleasedError(
            f"expected the {count} of '{kind}', of which {_some(missing)} {verb} missing; add the files that hold them"
        )
    if unexpected:
        raise ReleasedError(
            f"expected the {count} of '{kind}', got {_some(unexpected)} as well; is it of another kind?"
        )


def _names(kind: Kind, architecture: Architecture) -> set[str]:
    return {source.name for source in sources_of(kind, architecture).values() if source.name}


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:SHOWN])
    return shown if len(names) <= SHOWN else f"{len(names):,} ({shown}, ...)"
