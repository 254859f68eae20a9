"""Task masks: which entries of the merged task vector a task keeps (arXiv 2511.18810, after arXiv 2405.07813)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
import torch

from robogauntlet_mergevla.merging.errors import ExpertsDiffer, MergeError
from robogauntlet_mergevla.merging.recipe import LAMBDA, check_lambda
from robogauntlet_mergevla.merging.task_vectors import OnDemand, TaskVector, TaskVectors, Weights, difference

Mask = Mapping[str, torch.Tensor]
"""Weight name to a boolean tensor of the weight's shape, True where the merged value is kept."""
_BITS, _SHAPE = "bits/", "shape/"


class MaskMismatch(MergeError):
    """The mask belongs to another model, or its stored form is damaged."""


def task_mask(vector: TaskVector, merged: TaskVector, lambda_: float = LAMBDA) -> dict[str, torch.Tensor]:
    """S_m = 1[|tau_m| > lambda * |tau_merge - tau_m|], entry by entry (arXiv 2511.18810 equation 3).

    `vector` is the task's own, `merged` is tau_merge. The greater lambda, in (0, 2], the fewer entries are kept. Raises
    OutOfRange for another lambda, ExpertsDiffer if names or shapes of the two vectors differ.
    """
    check_lambda(lambda_)
    if problem := difference(merged, vector):
        raise ExpertsDiffer(f"the task vector does not fit the merged one: {problem}")
    return {name: delta.abs() > lambda_ * (merged[name] - delta).abs() for name, delta in vector.items()}


def task_masks(
    task_vectors: TaskVectors, merged: TaskVector, lambdas: float | Mapping[str, float] = LAMBDA
) -> dict[str, dict[str, torch.Tensor]]:
    """Return the mask of each task, see `task_mask` and `lambdas_of`."""
    chosen = lambdas_of(task_vectors, lambdas)
    return {expert: task_mask(vector, merged, chosen[expert]) for expert, vector in task_vectors.items()}


def lambdas_of(task_vectors: TaskVectors, lambdas: float | Mapping[str, float]) -> dict[str, float]:
    """Return the lambda of each expert from one for all, or from a mapping by expert name.

    Raises OutOfRange for a lambda outside (0, 2], ExpertsDiffer if the lambdas are those of other experts.
    """
    chosen = dict(lambdas) if isinstance(lambdas, Mapping) else dict.fromkeys(task_vectors, lambdas)
    if chosen.keys() != task_vectors.keys():
        odd = sorted(chosen.keys() ^ task_vectors.keys())[0]
        raise ExpertsDiffer(f"expected a lambda for each of {', '.join(task_vectors)}; {odd} is in one of them only")
    for value in chosen.values():
        check_lambda(value)
    return chosen


def check_mask(mask: Mask, weights: Weights) -> None:
    """Raise MaskMismatch if the mask's names or shapes are not those of the weights, or an entry is not boolean."""
    if problem := difference(weights, mask):
        raise MaskMismatch(f"the mask is for another model: {problem}")
    for name, kept in mask.items():
        if kept.dtype != torch.bool:
            raise MaskMismatch(f"the mask of weight {name}: expected torch.bool, got {kept.dtype}")


def masked(merged: TaskVector, mask: Mask) -> dict[str, torch.Tensor]:
    """S_m * tau_merge. Raises MaskMismatch if the mask is for another model."""
    check_mask(mask, merged)
    return {name: torch.where(mask[name], delta, 0.0) for name, delta in merged.items()}


def pack_mask(mask: Mask) -> dict[str, torch.Tensor]:
    """Return a mask as tensors that safetensors can store: eight entries per byte, and the shapes.

    Returns:
        `bits/<weight>`: uint8, ceil(entries / 8) bytes, first entry in the highest bit, padded with zeros;
        `shape/<weight>`: int64, one number per axis.
    """
    packed = {}
    for name, kept in mask.items():
        packed[_BITS + name] = torch.from_numpy(np.packbits(kept.detach().cpu().reshape(-1).numpy()))
        packed[_SHAPE + name] = torch.tensor(kept.shape, dtype=torch.int64)
    return packed


def unpack_mask(packed: Weights) -> Mask:
    """Return the mask that `pack_mask` packed; a weight's part is unpacked when it is asked for.

    Raises MaskMismatch if a part is missing, has another type or length, or if padding is not zero.
    """
    stray = sorted(name for name in packed if not name.startswith((_BITS, _SHAPE)))
    if stray:
        raise MaskMismatch(f"expected tensors named {_BITS}... and {_SHAPE}... in a packed mask, got {stray[0]}")
    bits = {name.removeprefix(_BITS): tensor for name, tensor in packed.items() if name.startswith(_BITS)}
    shapes = {name.removeprefix(_SHAPE): tensor for name, tensor in packed.items() if name.startswith(_SHAPE)}
    if bits.keys() != shapes.keys():
        raise MaskMismatch(f"expected bits and shape for each weight, {sorted(bits.keys() ^ shapes.keys())[0]} has one")
    sizes = {name: _checked_size(name, bits[name], shapes[name]) for name in bits}
    return OnDemand({name: partial(_unpacked, bits[name], size) for name, size in sizes.items()})


def _checked_size(name: str, bits: torch.Tensor, shape: torch.Tensor) -> tuple[int, ...]:
    if bits.dtype != torch.uint8 or bits.ndim != 1 or shape.dtype != torch.int64 or shape.ndim != 1:
        raise MaskMismatch(f"packed mask of {name}: expected flat uint8 bits and int64 shape, got {bits.dtype} bits")
    size = tuple(shape.tolist())
    if min(size, default=0) < 0:
        raise MaskMismatch(f"packed mask of {name}: expected a shape, got {size}")
    entries = int(np.prod(size, dtype=np.int64))
    if len(bits) != packed_bytes(entries):
        raise MaskMismatch(f"packed mask of {name}: expected {packed_bytes(entries)} bytes for {size}, got {len(bits)}")
    if len(bits) and np.unpackbits(bits[-1:].cpu().numpy())[entries - 8 * (len(bits) - 1) :].any():
        raise MaskMismatch(f"packed mask of {name}: expected zeros after its {entries} entries, got others")
    return size


def _unpacked(bits: torch.Tensor, size: tuple[int, ...]) -> torch.Tensor:
    flat = np.unpackbits(bits.cpu().numpy(), count=int(np.prod(size, dtype=np.int64)))
    return torch.from_numpy(flat.view(bool)).reshape(size)


def packed_bytes(entries: int) -> int:
    """Size in bytes of a packed mask with this number of entries."""
    return -(-entries // 8)
