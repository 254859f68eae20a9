"""Saving and loading networks as folders: `model.safetensors` with the tensors, `card.json` with everything else."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from policies.mergevla.card import (
    CARD,
    WEIGHTS,
    Card,
    CheckpointError,
    base_folder,
    hash_tensors,
    locate,
    read_card,
    verified_card,
)
from policies.mergevla.config import Architecture
from policies.mergevla.lora import add_lora, has_lora, plain_name
from policies.mergevla.merged_card import MergedCard
from policies.mergevla.model import MergeVLA

AnyCard = TypeVar("AnyCard", Card, MergedCard)


@dataclass(frozen=True)
class Checkpoint:
    """A network and what is known about it."""

    model: MergeVLA
    """In evaluation mode; with its adapters, if the card names any."""
    card: Card


def save_checkpoint(folder: Path, model: MergeVLA, card: Card, base: str | Path | None = None) -> Card:
    """Write a checkpoint. A file is complete under its name or not there.

    Args:
        folder: Where to, made if need be.
        model: What to save; its adapters stay factors.
        card: What to say about it; hashes and the base's name are filled in.
        base: Checkpoint that stays where it is, a folder or a hub id: tensors equal to its own are left out.

    Returns:
        The card as written.

    Raises:
        CheckpointError: NaN or infinite weights, or a card of another network.
    """
    if card.architecture != model.architecture or (card.lora is not None) != has_lora(model):
        raise CheckpointError("expected a card of the model's own architecture and LoRA, got another's")
    tensors = tensors_of(model)
    check_finite(tensors, folder)
    folder.mkdir(parents=True, exist_ok=True)
    if base is not None:
        shared, base_card = load_tensors(base)
        if base_card.base is not None:
            raise CheckpointError(f"expected a base that stands alone, got '{base}', which builds on {base_card.base}")
        tensors = {n: t for n, t in tensors.items() if n not in shared or not torch.equal(t, shared[n])}
        card = replace(card, base=name_of_base(folder, base), base_hash=base_card.tensor_hash)
    return write_folder(folder, tensors, card)


def write_folder(folder: Path, tensors: Mapping[str, Tensor], card: AnyCard) -> AnyCard:
    """Write tensors and card into a folder that exists, each complete under its name or not there.

    Returns:
        The card with the tensors' hash.

    Raises:
        OSError: The disk is full, or the folder cannot be written.
    """
    partial = folder / f"{WEIGHTS}.partial"
    write_tensors(partial, tensors)
    card = card.sealed(hash_tensors(partial))
    partial.replace(folder / WEIGHTS)
    text = folder / f"{CARD}.partial"
    text.write_text(json.dumps(card.as_json(), indent=1, sort_keys=True, allow_nan=False) + "\n")
    text.replace(folder / CARD)
    return card


def write_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: dict[str, str] | None = None) -> None:
    """Write a safetensors file, or none.

    Raises:
        OSError: The disk is full, or the file cannot be written; safetensors says it as an error of its own.
    """
    try:
        save_file(dict(tensors), path, metadata=metadata)
    except SafetensorError as error:
        path.unlink(missing_ok=True)
        number = re.search(r"\(os error (\d+)\)", str(error))
        if number is None:
            raise
        raise OSError(int(number[1]), os.strerror(int(number[1])), str(path)) from None


def load_checkpoint(reference: str | Path, expected: Architecture | None = None) -> Checkpoint:
    """Read a checkpoint, verified.

    Args:
        reference: A folder or a hub id.
        expected: Architecture that it must have, or None for any.

    Raises:
        PolicyError: Truncated, of another architecture, with NaN weights, without statistics, not of the card's hash,
            or a pickle.
    """
    folder = locate(str(reference))
    if expected is not None:
        check_architecture(folder, expected, read_card(folder).architecture)
    tensors, card = load_tensors(folder)
    model = empty_model(card)
    own = model.state_dict()
    names = {plain_name(name): name for name in own}
    for name in sorted(names.keys() | tensors.keys()):
        wanted = tuple(own[names[name]].shape) if name in names else "no such tensor"
        came = tuple(tensors[name].shape) if name in tensors else "none"
        if wanted != came:
            raise CheckpointError(f"'{folder}': expected {name} of shape {wanted} by its card, got {came}")
    model.load_state_dict({names[name]: tensor for name, tensor in tensors.items()}, assign=True)
    return Checkpoint(model.eval(), card)


def load_tensors(reference: str | Path) -> tuple[dict[str, Tensor], Card]:
    """A checkpoint's tensors by their names in the plain network, those of its base included, and its card.

    Factors are named `<layer>.lora_A` and `<layer>.lora_B`.

    Raises:
        PolicyError: See `load_checkpoint`.
    """
    folder = locate(str(reference))
    card = verified_card(folder)
    tensors: dict[str, Tensor] = {}
    if card.base is not None:
        beneath = base_folder(folder, card.base)
        base_card = verified_card(beneath)
        if base_card.base is not None:
            raise CheckpointError(f"expected a base that stands alone, got '{beneath}', which builds on another")
        check_architecture(beneath, card.architecture, base_card.architecture)
        tensors = load_file(beneath / WEIGHTS)
    tensors |= load_file(folder / WEIGHTS)
    check_finite(tensors, folder)
    return tensors, card


def tensors_of(model: MergeVLA) -> dict[str, Tensor]:
    """All tensors on the CPU, by their names in the plain network."""
    return {plain_name(name): tensor.detach().cpu().contiguous() for name, tensor in model.state_dict().items()}


def empty_model(card: Card) -> MergeVLA:
    """The network that the card describes, with weights that mean nothing; the global generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        model = MergeVLA(card.architecture)
    if card.lora is not None:
        add_lora(model, card.lora, seed=0)
    return model


def name_of_base(folder: Path, base: str | Path) -> str:
    """A folder relative to the checkpoint's own, so that both can be moved together; a hub id as it is."""
    if not Path(base).is_dir():
        return str(base)
    return Path(os.path.relpath(Path(base).resolve(), folder.resolve())).as_posix()


def check_finite(tensors: Mapping[str, Tensor], folder: Path) -> None:
    """Refuse NaN and infinity.

    Raises:
        CheckpointError: There are some; `folder` is for the message.
    """
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise CheckpointError(f"'{folder}': expected finite weights, got NaN or infinity in {name}")


def check_architecture(folder: Path, expected: Architecture, came: Architecture) -> None:
    """Refuse another architecture than the expected one.

    Raises:
        CheckpointError: It is another; `folder` is for the message.
    """
    if expected == came:
        return
    ours, theirs = expected.as_json(), came.as_json()
    differing = next(name for name in ours if ours[name] != theirs[name])
    raise CheckpointError(
        f"'{folder}': expected architecture '{expected.name}' with {differing} {ours[differing]}, "
        f"got '{came.name}' with {theirs[differing]}"
    )
