"""Saving and loading networks as folders: `model.safetensors` with the tensors, `card.json` with everything else."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import TypeVar

import torch
from accelerate import init_empty_weights
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from robogauntlet.support.files import replacing, write_whole
from robogauntlet.support.text import shortened
from robogauntlet_mergevla.checkpoints.merged_metadata import MergedMetadata
from robogauntlet_mergevla.checkpoints.metadata import (
    METADATA_FILE,
    WEIGHTS,
    CheckpointError,
    CheckpointMetadata,
    base_folder,
    hash_tensors,
    locate,
    open_weights,
)
from robogauntlet_mergevla.network.config import Architecture
from robogauntlet_mergevla.network.lora import add_lora, factor_shapes, folded, has_lora, plain_name
from robogauntlet_mergevla.network.model import MergeVLA, assembled, empty

AnyMetadata = TypeVar("AnyMetadata", CheckpointMetadata, MergedMetadata)
LONGEST_VALUE = 300
"""Characters of an architecture's value in a message."""


@dataclass(frozen=True)
class Checkpoint:
    """A network and its metadata."""

    model: MergeVLA
    """In evaluation mode; with its adapters, if its metadata names any."""
    metadata: CheckpointMetadata


def save_checkpoint(
    folder: Path,
    model: MergeVLA,
    metadata: CheckpointMetadata,
    base: str | Path | None = None,
    *,
    dtype: torch.dtype | None = None,
) -> CheckpointMetadata:
    """Write a checkpoint. Each file appears only once it is complete.

    Args:
        folder: Folder of the checkpoint, created if necessary.
        model: Network to save; its adapters stay factors.
        metadata: Its metadata; returned with hashes and the base's name filled in.
        base: Folder or hub id of the base, which must stay in place: tensors equal to the base's are left out.
        dtype: Type to which the weights are rounded in the file; None for the model's own.

    Raises:
        CheckpointError: NaN or infinite weights, or metadata of another network.
        OSError: The files cannot be written.
    """
    if metadata.architecture != model.architecture or (metadata.lora is not None) != has_lora(model):
        raise CheckpointError("expected metadata of the model's own architecture and LoRA, got another's")
    tensors = {name: tensor.to(dtype or tensor.dtype) for name, tensor in tensors_of(model).items()}
    check_finite(tensors, folder)
    folder.mkdir(parents=True, exist_ok=True)
    if base is not None:
        shared, base_metadata = load_tensors(base)
        if base_metadata.base is not None:
            raise CheckpointError(
                f"expected a base without a base of its own, got '{base}', which has {base_metadata.base}"
            )
        tensors = {n: t for n, t in tensors.items() if n not in shared or not torch.equal(t, shared[n].to(t.dtype))}
        metadata = replace(metadata, base=name_of_base(folder, base), base_hash=base_metadata.tensor_hash)
    return write_folder(folder, tensors, metadata)


def write_folder(folder: Path, tensors: Mapping[str, Tensor], metadata: AnyMetadata) -> AnyMetadata:
    """Write tensors and metadata into an existing folder and return the metadata with the tensors' hash.

    Each file appears only once it is complete. Raises OSError if the files cannot be written.
    """
    with replacing(folder / WEIGHTS) as partial:
        write_tensors(tensors, partial)
        metadata = replace(metadata, tensor_hash=hash_tensors(partial))
    write_whole(
        folder / METADATA_FILE, json.dumps(metadata.as_json(), indent=1, sort_keys=True, allow_nan=False) + "\n"
    )
    return metadata


def load_checkpoint(reference: str | Path) -> Checkpoint:
    """Read and verify a checkpoint, a folder or a hub id.

    Raises:
        PolicyError: It is truncated, a pickle, of another architecture or hash than in its metadata, without
            statistics, or has NaN weights.
    """
    return _network(*load_verified(reference))


def load_folded(reference: str | Path) -> Checkpoint:
    """Read a checkpoint as `load_checkpoint` does, with its adapters added to the weights, so that it can only act."""
    tensors, metadata = load_verified(reference)
    if metadata.lora is None:
        return _network(tensors, metadata)
    return Checkpoint(assembled(metadata.architecture, folded(tensors, metadata.lora)).eval(), metadata)


def _network(tensors: Mapping[str, Tensor], metadata: CheckpointMetadata) -> Checkpoint:
    model = empty(metadata.architecture)
    if metadata.lora is not None:
        with init_empty_weights(include_buffers=False):
            add_lora(model, metadata.lora, seed=0)
    names = {plain_name(name): name for name in model.state_dict()}
    model.load_state_dict({names[name]: tensor for name, tensor in tensors.items()}, assign=True)
    return Checkpoint(model.eval(), metadata)


def load_verified(reference: str | Path) -> tuple[dict[str, Tensor], CheckpointMetadata]:
    """Return what `load_tensors` does, if these are the tensors of the network in the metadata; raise PolicyError."""
    folder = locate(str(reference))
    tensors, metadata = load_tensors(folder)
    model = empty(metadata.architecture)  # of shapes only: metadata may tell of a network larger than any memory
    expected_shapes = {name: tuple(tensor.shape) for name, tensor in model.state_dict().items()}
    if metadata.lora is not None:
        expected_shapes |= factor_shapes(model, metadata.lora)
    for name in sorted(expected_shapes.keys() | tensors.keys()):
        expected = expected_shapes.get(name, "no such tensor")
        shape = tuple(tensors[name].shape) if name in tensors else "none"
        if expected != shape:
            raise CheckpointError(f"'{folder}': expected {name} of shape {expected} by its metadata, got {shape}")
    return tensors, metadata


def load_tensors(reference: str | Path) -> tuple[dict[str, Tensor], CheckpointMetadata]:
    """Return a checkpoint's tensors, with those of its base, by their names in the plain network, and its metadata.

    Factors are named `<layer>.lora_A` and `<layer>.lora_B`. Tensors that were stored in fewer bits than the base's are
    returned in the base's type. Raises PolicyError as `load_checkpoint` does.
    """
    folder = locate(str(reference))
    metadata = CheckpointMetadata.verified(folder)
    tensors: dict[str, Tensor] = {}
    if metadata.base is not None:
        base = base_folder(folder, metadata.base)
        check_architecture(base, metadata.architecture, CheckpointMetadata.read(base).architecture)
        tensors = read_tensors(base / WEIGHTS)
    dtypes = {tensor.dtype for tensor in tensors.values()}
    for name, tensor in read_tensors(folder / WEIGHTS).items():
        tensors[name] = tensor.to(reduce(torch.promote_types, dtypes, tensor.dtype))
    check_finite(tensors, folder)
    return tensors, metadata


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Read the tensors of a file onto the CPU. Raises CheckpointError if it violates the format or cannot be read."""
    with open_weights(path):
        pass
    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise CheckpointError(f"expected a safetensors file in '{path}', got: {error}") from None


def write_tensors(tensors: Mapping[str, Tensor], path: Path, metadata: Mapping[str, str] | None = None) -> None:
    """Write tensors, or no file. Raises OSError also where the library has its own error, such as for a full disk."""
    path.unlink(missing_ok=True)
    path.touch()
    mode = path.stat().st_mode
    try:
        save_file(dict(tensors), path, metadata=dict(metadata) if metadata else None)
        with suppress(OSError):  # the library lets nobody else read it; some file systems have no modes
            path.chmod(mode)
    except SafetensorError as error:
        path.unlink(missing_ok=True)
        number = re.search(r"os error (\d+)", str(error))
        if number is None:
            raise
        code = int(number[1])
        raise OSError(code, os.strerror(code), str(path)) from None


def tensors_of(model: MergeVLA) -> dict[str, Tensor]:
    """Return all tensors, on the CPU, by their names in the plain network."""
    return {plain_name(name): tensor.detach().cpu().contiguous() for name, tensor in model.state_dict().items()}


def name_of_base(folder: Path, base: str | Path) -> str:
    """Return a base's folder relative to the checkpoint's, so that both can be moved together, or its hub id."""
    if not Path(base).is_dir():
        return str(base)
    return Path(os.path.relpath(Path(base).resolve(), folder.resolve())).as_posix()


def check_finite(tensors: Mapping[str, Tensor], folder: Path) -> None:
    """Raise CheckpointError, which names `folder`, if a tensor has NaN or infinite entries."""
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise CheckpointError(f"'{folder}': expected finite weights, got NaN or infinity in {name}")


def check_architecture(folder: Path, expected: Architecture, given: Architecture) -> None:
    """Raise CheckpointError, which names `folder`, if the architectures differ."""
    if expected == given:
        return
    ours, theirs = expected.as_json(), given.as_json()
    differing = next(name for name in ours if ours[name] != theirs[name])

    def value(one: Mapping[str, object], name: str) -> str:
        return shortened(str(one[name]), LONGEST_VALUE)

    raise CheckpointError(
        f"'{folder}': expected architecture '{value(ours, 'name')}' with {differing} {value(ours, differing)}, "
        f"got '{value(theirs, 'name')}' with {value(theirs, differing)}"
    )
