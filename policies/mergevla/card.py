"""A checkpoint's folder without its weights: where it is, what its card says, and whether its tensors are the ones.

Light: reads the safetensors file's header and hashes its bytes, so that a run can be planned without torch.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

from policies.contract import PolicyError
from policies.mergevla.config import Architecture, LoraSettings
from policies.mergevla.normalisation import TaskStatistics
from policies.zoo import shipped
from suites.vocabulary import content_hash

WEIGHTS, CARD, FORMAT = "model.safetensors", "card.json", 1
PICKLES = (".bin", ".pt", ".pth", ".pkl", ".pickle", ".ckpt")
LARGEST_HEADER = 100_000_000
"""Bytes, the limit of the safetensors format."""


class CheckpointError(PolicyError):
    """A checkpoint that cannot be used; the message says what was expected and what came."""


@dataclass(frozen=True)
class Card:
    """What a checkpoint says about itself."""

    architecture: Architecture
    statistics: TaskStatistics
    """Of each task that it was trained on."""
    action_steps: int | None = None
    """Actions of a chunk that are executed before the next look, at most (LeRobot's `n_action_steps`); None for all."""
    lora: LoraSettings | None = None
    base: str | None = None
    """Checkpoint that holds the tensors that are not stored here: a folder relative to this one, or a hub id."""
    base_hash: str | None = None
    """That checkpoint's `tensor_hash`."""
    data_hash: str | None = None
    """Hash of the training data."""
    metrics: Mapping[str, float] = field(default_factory=dict)
    """Losses, seeds and whatever else training recorded."""
    tensor_hash: str = ""
    """`hash_tensors` of the weights' file; filled in when the checkpoint is saved."""

    @property
    def tasks(self) -> tuple[str, ...]:
        """Tasks that it was trained on (`simulator/task`)."""
        return self.statistics.tasks

    @property
    def digest(self) -> str:
        """Hash of all that decides how the policy acts."""
        decisive = {
            "architecture": self.architecture.as_json(),
            "statistics": self.statistics.as_json(),
            "lora": asdict(self.lora) if self.lora else None,
            "tensors": self.tensor_hash,
            "base": self.base_hash,
        }
        return content_hash(decisive | ({"action_steps": self.action_steps} if self.action_steps else {}))

    def sealed(self, tensor_hash: str) -> Card:
        """The card for these tensors."""
        return replace(self, tensor_hash=tensor_hash)

    def as_json(self) -> dict[str, Any]:
        """As plain JSON; `Card.from_json` is the inverse."""
        return {
            "format": FORMAT,
            **asdict(self),
            "architecture": self.architecture.as_json(),
            "statistics": self.statistics.as_json(),
            "metrics": dict(self.metrics),
        }

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Card:
        """The card that `as_json` wrote.

        Raises:
            PolicyError: It is something else, or its statistics are missing.
        """
        parts = dict(plain)
        if (kind := parts.pop("kind", None)) is not None:
            raise CheckpointError(f"expected a checkpoint of one network, got a {kind} one")
        check_format(parts.pop("format", None))
        if not parts.get("statistics"):
            raise CheckpointError("expected normalisation statistics in the card, got none")
        parts["architecture"] = Architecture.from_json(parts.get("architecture") or {})
        parts["statistics"] = TaskStatistics.from_json(parts["statistics"])
        check_action_steps(parts.get("action_steps"), parts["architecture"])
        check_text(parts, "tensor_hash")
        check_text(parts, "base", "base_hash", "data_hash", or_none=True)
        try:
            parts["lora"] = LoraSettings(**parts["lora"]) if parts.get("lora") else None
            return cls(**parts)
        except TypeError as error:
            raise CheckpointError(f"expected a card, got one that does not read: {error}") from None


def locate(reference: str) -> Path:
    """The folder of a checkpoint.

    Args:
        reference: A folder, a hub id such as `owner/name` or `owner/name@revision`, or a part of the zoo, see
            `policies.zoo.shipped`.

    Raises:
        PolicyError: It is none of these, or it holds a pickle.
    """
    path = shipped(reference)
    if path.suffix in PICKLES:
        raise _pickle(path.name, path.parent)
    if path.is_dir():
        try:
            pickles = sorted(file.name for file in path.iterdir() if file.suffix in PICKLES)
        except OSError as error:
            raise CheckpointError(f"expected to read '{path}', got: {error.strerror}") from None
        if pickles and not (path / WEIGHTS).is_file():
            raise _pickle(pickles[0], path)
        return path
    if path.exists() or not re.fullmatch(r"[\w][\w.-]*/[\w][\w.-]*(@[\w./-]+)?", reference):
        raise CheckpointError(f"expected a checkpoint's folder or a hub id, got '{reference}'")
    return _from_hub(reference)


def read_card(folder: Path) -> Card:
    """The card of the checkpoint in `folder`.

    Raises:
        PolicyError: There is none, or it does not read.
    """
    plain = card_json(folder)
    try:
        return Card.from_json(plain)
    except PolicyError as error:
        raise type(error)(f"'{folder}': {error}") from None


def card_json(folder: Path) -> dict[str, Any]:
    """What the card's file in `folder` holds.

    Raises:
        CheckpointError: There is none, or it holds no JSON object.
    """
    try:
        plain = json.loads((folder / CARD).read_text())
    except FileNotFoundError:
        raise CheckpointError(f"expected {CARD} in '{folder}', got a folder without it") from None
    except OSError as error:
        raise CheckpointError(f"expected to read '{folder / CARD}', got: {error.strerror}") from None
    except ValueError as error:
        raise CheckpointError(f"expected JSON in '{folder / CARD}', got: {error}") from None
    if not isinstance(plain, dict):
        raise CheckpointError(f"expected a JSON object in '{folder / CARD}', got {type(plain).__name__}")
    return plain


def check_format(came: object) -> None:
    """Refuse a card that another version wrote.

    Raises:
        CheckpointError: It did.
    """
    if came != FORMAT:
        raise CheckpointError(f"expected a card of format {FORMAT}, got {came}")


def check_text(parts: Mapping[str, Any], *names: str, or_none: bool = False) -> None:
    """Refuse a card's entries that are there and no text.

    Raises:
        CheckpointError: One is none; `or_none`, and is not None either.
    """
    for name in names:
        if name in parts and not isinstance(parts[name], str) and not (or_none and parts[name] is None):
            raise CheckpointError(f"expected {name} to be text, got {parts[name]!r}")


def check_action_steps(came: object, architecture: Architecture) -> None:
    """Refuse numbers of executed actions that no chunk of this architecture has.

    Raises:
        CheckpointError: It is one.
    """
    most = architecture.chunk_length
    if came is not None and not (type(came) is int and 1 <= came <= most):
        raise CheckpointError(f"expected 1 to {most} action steps, the length of a chunk, got {came}")


def verified_card(folder: Path) -> Card:
    """The card, once the weights' file beside it and the base's are found to be the ones it speaks of.

    Raises:
        PolicyError: They are not.
    """
    card = read_card(folder)
    check_hash(folder / WEIGHTS, card.tensor_hash, hash_tensors(folder / WEIGHTS))
    if card.base is not None:
        base = base_folder(folder, card.base)
        check_hash(base / WEIGHTS, card.base_hash or "", read_card(base).tensor_hash)
    return card


def base_folder(folder: Path, base: str) -> Path:
    """Where the checkpoint is that the card in `folder` builds on and calls `base`.

    Raises:
        CheckpointError: It is neither there nor on a hub.
    """
    beside = folder / base
    try:
        return locate(str(beside) if beside.is_dir() else base)
    except PolicyError as error:
        raise CheckpointError(f"'{folder}': expected its base at '{base}': {error}") from None


def digest_of(reference: str) -> str:
    """Hash of a checkpoint's content, verified.

    Raises:
        PolicyError: It cannot be used.
    """
    folder = locate(reference)
    card = verified_card(folder)
    if card.base is not None:
        verified_card(base_folder(folder, card.base))
    return card.digest


def hash_tensors(path: Path) -> str:
    """SHA-256 over name, type, shape and bytes of each tensor of a safetensors file, in the order of their names.

    Raises:
        CheckpointError: The file is missing, truncated, or of another format.
    """
    if not path.is_file():
        raise CheckpointError(f"expected {path.name} in '{path.parent}', got a folder without it")
    state = path.stat()
    return _hash_file(path.resolve(), state.st_mtime_ns, state.st_size, state.st_ino)


@lru_cache(maxsize=256)
def _hash_file(path: Path, changed_ns: int, size: int, inode: int) -> str:
    """A file's hash, kept until the file changes: a suite may name the same experts in two hundred policies."""
    digest = hashlib.sha256()
    try:
        file = path.open("rb")
    except OSError as error:
        raise CheckpointError(f"expected to read '{path}', got: {error.strerror}") from None
    with file:
        start, header = _read_header(path, file)
        for name in sorted(header):
            entry = header[name]
            first, last = entry["data_offsets"]
            if start + last > size:
                raise CheckpointError(f"expected {start + last} bytes or more in '{path}', got {size}: it is truncated")
            file.seek(start + first)
            digest.update(json.dumps([name, entry["dtype"], entry["shape"]]).encode() + b"\0")
            digest.update(file.read(last - first))
    whole = start + max((entry["data_offsets"][1] for entry in header.values()), default=0)
    if whole != size:
        raise CheckpointError(f"expected {whole} bytes in '{path}', got {size}: something follows its tensors")
    return digest.hexdigest()


def _read_header(path: Path, file: BinaryIO) -> tuple[int, dict[str, Any]]:
    """Where the tensors' bytes begin, and name to type, shape and place of each tensor."""
    length = int.from_bytes(file.read(8), "little")
    text = file.read(length) if length <= LARGEST_HEADER else b""
    try:
        header = json.loads(text)
        header.pop("__metadata__", None)
        places = [entry["data_offsets"] for entry in header.values() if entry["dtype"] and entry["shape"] is not None]
        if any(not 0 <= first <= last for first, last in places):
            raise ValueError("offsets out of order")
    except (AttributeError, KeyError, TypeError, ValueError):
        raise CheckpointError(
            f"expected a safetensors file in '{path}', got a truncated one or another format"
        ) from None
    return 8 + length, header


def check_hash(path: Path, expected: str, came: str) -> None:
    """Refuse tensors that are not the ones a card speaks of.

    Raises:
        CheckpointError: The hashes differ.
    """
    if expected != came:
        raise CheckpointError(f"expected tensors of hash {expected[:16] or '(none)'} for '{path}', got {came[:16]}")


def _pickle(name: str, folder: Path) -> CheckpointError:
    return CheckpointError(
        f"expected {WEIGHTS} in '{folder}', got {name}, a pickle: refused, since loading one runs code"
    )


def _from_hub(reference: str) -> Path:
    from huggingface_hub import snapshot_download

    name, _, revision = reference.partition("@")
    try:
        return Path(snapshot_download(name, revision=revision or None, allow_patterns=[WEIGHTS, CARD]))
    except Exception as error:  # the hub's client raises its own, its transport's and the system's errors
        reason = str(error).strip().partition("\n")[0]
        raise CheckpointError(f"expected a folder or hub id, got '{reference}', which is no folder: {reason}") from None
