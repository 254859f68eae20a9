"""A checkpoint's folder without its weights: where it is, its metadata, and a check of its tensors' hash.

Light: reads the safetensors file's header and hashes its bytes, so that a run can be planned without torch.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Self

from pydantic import StrictInt
from pydantic.dataclasses import dataclass

from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.hub import OnHub, check_download
from robogauntlet.policies.stored import STRICT, Stored, StoredError
from robogauntlet.suites.episode import content_hash
from robogauntlet.support.errors import first_line
from robogauntlet.support.files import open_regular, read_regular
from robogauntlet.support.json_text import parse_json
from robogauntlet.support.text import shortened
from robogauntlet_mergevla.checkpoints.tensor_file import StoredTensor, TensorFileError, read_header
from robogauntlet_mergevla.network.config import Architecture, LoraSettings
from robogauntlet_mergevla.network.normalisation import TaskStatistics
from robogauntlet_mergevla.zoo import shipped

WEIGHTS, METADATA_FILE, FORMAT = "model.safetensors", "card.json", 1
PICKLES = (".bin", ".pt", ".pth", ".pkl", ".pickle", ".ckpt")
LONGEST_REFERENCE = 200
"""Characters of the name of a checkpoint in a message."""
PIECE = 2**20
"""Bytes of a tensor that are in memory at a time while it is hashed."""


class CheckpointError(StoredError):
    """A checkpoint that cannot be used."""


class StoredMetadata(Stored):
    """The metadata that checkpoints of one network and of a merged model share."""

    what: ClassVar = "checkpoint metadata"
    refusal: ClassVar = CheckpointError
    kind: ClassVar[str | None] = None
    """Value of `kind` in the file; a checkpoint of one network has none."""
    left_out_if_empty: ClassVar[tuple[str, ...]] = ()
    """Fields that most checkpoints do not need, and that earlier versions do not read."""
    base: str | None
    base_hash: str | None
    tensor_hash: str

    def as_json(self) -> dict[str, Any]:
        """Return the metadata as plain JSON; `from_json` is the inverse."""
        plain = {"format": FORMAT} | ({"kind": self.kind} if self.kind else {}) | super().as_json()
        return {name: value for name, value in plain.items() if value or name not in self.left_out_if_empty}

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Self:
        """Read what `as_json` wrote. Raises PolicyError if it is of another kind or format, or malformed."""
        fields = dict(plain)
        if (kind := fields.pop("kind", None)) != cls.kind:
            raise CheckpointError(f"expected {_described(cls.kind)}, got {_described(kind)}")
        if (version := fields.pop("format", None)) != FORMAT:
            raise CheckpointError(f"expected metadata of format {FORMAT}, got {version}")
        return super().from_json(fields)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read the metadata of the checkpoint in `folder`. Raises PolicyError if they are missing or malformed."""
        return _read(cls.from_json, folder, _metadata_text(folder))

    @classmethod
    def verified(cls, folder: Path) -> Self:
        """Read the metadata and check the tensors beside it, and those of the base, by their hashes.

        Raises:
            PolicyError: Malformed metadata, tensors of another hash, or a base that builds on another base.
        """
        metadata = cls.read(folder)
        _check_hash(folder, metadata.tensor_hash)
        if metadata.base is not None:
            base = base_folder(folder, metadata.base)
            base_metadata = CheckpointMetadata.read(base)
            if base_metadata.base is not None:
                raise CheckpointError(f"expected a base without a base of its own, got '{base}'")
            _check_hash(base, metadata.base_hash or "")
            _check_hash(base, base_metadata.tensor_hash)
        return metadata


def _described(kind: str | None) -> str:
    return f"a {kind} checkpoint" if kind else "a checkpoint of one network"


@dataclass(frozen=True, config=STRICT)
class CheckpointMetadata(StoredMetadata):
    """Everything about a checkpoint of one network except its tensors."""

    left_out_if_empty: ClassVar = ("trained_on",)

    architecture: Architecture
    statistics: TaskStatistics
    """Normalisation statistics of each task that it was trained on; those of an expert of several tasks are of all of
    them together, under the expert's name."""
    trained_on: tuple[str, ...] = ()
    """Tasks of an expert of several; empty if each task has statistics of its own."""
    action_steps: StrictInt | None = None
    """Largest number of a chunk's actions that are executed (LeRobot's `n_action_steps`); None for all."""
    lora: LoraSettings | None = None
    base: str | None = None
    """Checkpoint with the tensors that are not stored in this one: a folder relative to this one, or a hub id."""
    base_hash: str | None = None
    """`tensor_hash` of the base."""
    data_hash: str | None = None
    """Hash of the training data."""
    metrics: Mapping[str, int | float] = field(default_factory=dict)
    """Losses, seeds and other records of the training."""
    tensor_hash: str = ""
    """`hash_tensors` of the weights' file; filled in when the checkpoint is saved."""

    def __post_init__(self) -> None:
        check_action_steps(self.action_steps, self.architecture)
        check_statistics(self.statistics, self.architecture)

    @property
    def tasks(self) -> tuple[str, ...]:
        """Tasks that it was trained on (`simulator/task`)."""
        return self.trained_on or self.statistics.tasks

    @property
    def expert(self) -> str:
        """Name of an expert: its task, or the name of an expert of several. Raises CheckpointError if it is none."""
        if self.base is None or self.base_hash is None or self.lora is None:
            raise CheckpointError("expected an expert with adapters on a base, got none")
        if len(self.statistics.tasks) != 1:
            raise CheckpointError(
                "expected an expert with statistics of all its tasks together, as 'mergevla finetune' trains one, "
                f"got those of each of {', '.join(self.tasks)}"
            )
        return self.statistics.tasks[0]

    @property
    def digest(self) -> str:
        """Hash of everything that decides how the policy acts."""
        decisive = {
            "architecture": self.architecture.as_json(),
            "statistics": self.statistics.as_json(),
            "lora": self.lora.as_json() if self.lora else None,
            "tensors": self.tensor_hash,
            "base": self.base_hash,
        }
        return content_hash(decisive | ({"action_steps": self.action_steps} if self.action_steps else {}))


def locate(reference: str) -> Path:
    """Return the folder of a checkpoint; one on a hub is downloaded.

    Args:
        reference: A folder, a hub id such as `owner/name` or `owner/name@revision`, or a part of the zoo, see
            `robogauntlet_mergevla.zoo.shipped`.

    Raises:
        PolicyError: It is none of these, or it holds a pickle.
    """
    path = shipped(reference)
    if path.suffix in PICKLES:
        raise _pickle(path.name, path.parent)
    try:
        if path.is_dir():
            pickles = sorted(file.name for file in path.iterdir() if file.suffix in PICKLES)
            if pickles and not (path / WEIGHTS).is_file():
                raise _pickle(pickles[0], path)
            return path
        is_there = path.exists()
    except OSError as error:
        shown = shortened(str(path), LONGEST_REFERENCE)
        raise CheckpointError(f"expected to read '{shown}', got: {error.strerror}") from None
    if is_there or not re.fullmatch(r"[\w][\w.-]*/[\w][\w.-]*(@[\w./-]+)?", reference):
        raise CheckpointError(f"expected a checkpoint's folder or a hub id, got '{reference}'")
    return _from_hub(reference)


def read_metadata_file(folder: Path) -> dict[str, Any]:
    """Read the metadata file of `folder`. Raises CheckpointError if it is missing or holds no JSON object."""
    return _json_object(folder, _metadata_text(folder))


def _metadata_text(folder: Path) -> str:
    try:
        return read_regular(folder / METADATA_FILE).decode()
    except FileNotFoundError:
        raise CheckpointError(f"expected {METADATA_FILE} in '{folder}', got a folder without it") from None
    except OSError as error:
        raise CheckpointError(f"expected to read '{folder / METADATA_FILE}', got: {error.strerror}") from None
    except ValueError as error:
        raise _no_json(folder, error) from None


def _no_json(folder: Path, error: ValueError) -> CheckpointError:
    return CheckpointError(f"expected JSON in '{folder / METADATA_FILE}', got: {error}")


def _json_object(folder: Path, text: str) -> dict[str, Any]:
    try:
        plain = parse_json(text)
    except ValueError as error:
        raise _no_json(folder, error) from None
    if not isinstance(plain, dict):
        raise CheckpointError(f"expected a JSON object in '{folder / METADATA_FILE}', got {type(plain).__name__}")
    return plain


@lru_cache(maxsize=256)
def _read(from_json: Callable[[Mapping[str, Any]], Any], folder: Path, text: str) -> Any:
    """Metadata from the text of their file, which a suite may name in two hundred policies."""
    plain = _json_object(folder, text)
    try:
        return from_json(plain)
    except PolicyError as error:
        raise type(error)(f"'{folder}': {error}") from None


def check_action_steps(steps: int | None, architecture: Architecture) -> None:
    """Raise CheckpointError if `steps` is not from 1 to the length of the architecture's chunks."""
    if steps is not None and not 1 <= steps <= architecture.chunk_length:
        raise CheckpointError(
            f"expected 1 to {architecture.chunk_length} action steps, the length of a chunk, got {steps}"
        )


def check_statistics(statistics: TaskStatistics, architecture: Architecture) -> None:
    """Raise CheckpointError if statistics are of more numbers than the architecture has."""
    if (numbers := max(statistics.action_dims)) > architecture.action_dim:
        raise CheckpointError(
            f"expected statistics of actions of {architecture.action_dim} numbers, as the network's, got of {numbers}"
        )


def base_folder(folder: Path, base: str, what: str = "base") -> Path:
    """Return the folder of the base that the metadata in `folder` name, or of another checkpoint, which is then `what`.

    Raises CheckpointError if it is neither a folder nor on a hub.
    """
    beside = folder / base
    shown = shortened(base, LONGEST_REFERENCE)
    try:
        return locate(str(beside) if beside.is_dir() else base)
    except OSError as error:
        raise CheckpointError(f"'{folder}': expected its {what} at '{shown}': {error.strerror}") from None
    except OnHub:
        raise
    except PolicyError as error:
        raise CheckpointError(f"'{folder}': expected its {what} at '{shown}': {error}") from None


def digest_of(reference: str) -> str:
    """Return the hash of a checkpoint's content. Raises PolicyError if the checkpoint cannot be used."""
    return CheckpointMetadata.verified(locate(reference)).digest


def checkpoint_files(reference: str | Path) -> tuple[Path, tuple[Path, ...]]:
    """Return a checkpoint's folder, and its files with those of a local base and of local experts that it refers to.

    What is on a hub is left out.
    """
    folder = locate(str(reference)).resolve()
    plain = read_metadata_file(folder)
    base, experts = plain.get("base"), plain.get("checkpoints")
    beside = [base, *(experts.values() if isinstance(experts, dict) else ())]
    folders = [folder / other for other in beside if isinstance(other, str) and (folder / other).is_dir()]
    own = tuple(folder / name for name in (METADATA_FILE, WEIGHTS))
    return folder, tuple(dict.fromkeys((*own, *all_files(folders))))


def all_files(references: Iterable[str | Path]) -> tuple[Path, ...]:
    """Return the files of several checkpoints, each once."""
    return tuple(dict.fromkeys(file for reference in references for file in checkpoint_files(reference)[1]))


def hash_tensors(path: Path) -> str:
    """Return the SHA-256 over name, type, shape and bytes of each tensor of a safetensors file, ordered by name.

    Raises CheckpointError if the file is missing, truncated, or of another format.
    """
    if not path.is_file():
        raise CheckpointError(f"expected {path.name} in '{path.parent}', got a folder without it")
    state = path.stat()
    return _hash_file(path, state.st_mtime_ns, state.st_size, state.st_dev, state.st_ino)


@lru_cache(maxsize=256)
def _hash_file(path: Path, changed_ns: int, size: int, device: int, inode: int) -> str:
    """Hash a file, cached until it changes: a suite may name the same experts in two hundred policies."""
    digest = hashlib.sha256()
    with open_weights(path) as (file, tensors):
        for name in sorted(tensors):
            tensor = tensors[name]
            digest.update(json.dumps([name, tensor.dtype, tensor.shape]).encode() + b"\0")
            file.seek(tensor.start)
            for start in range(0, tensor.size, PIECE):
                digest.update(file.read(min(PIECE, tensor.size - start)))
    return digest.hexdigest()


@contextmanager
def open_weights(path: Path) -> Iterator[tuple[BinaryIO, Mapping[str, StoredTensor]]]:
    """A safetensors file and what its header says, which is checked before any tensor is read.

    Raises CheckpointError if it cannot be read, is no regular file, is truncated, or of another format.
    """
    try:
        with open_regular(path.resolve()) as file:
            yield file, read_header(file, os.fstat(file.fileno()).st_size)
    except OSError as error:
        raise CheckpointError(f"expected to read '{path}', got: {error.strerror}") from None
    except TensorFileError as error:
        raise CheckpointError(f"expected a safetensors file in '{path}', {error}") from None


def _check_hash(folder: Path, expected: str) -> None:
    actual = hash_tensors(folder / WEIGHTS)
    if expected != actual:
        raise CheckpointError(
            f"expected tensors of hash {expected[:16] or '(none)'} for '{folder / WEIGHTS}', got {actual[:16]}"
        )


def _pickle(name: str, folder: Path) -> CheckpointError:
    return CheckpointError(
        f"expected {WEIGHTS} in '{folder}', got {name}, a pickle: refused, since loading one runs code"
    )


def _from_hub(reference: str) -> Path:
    check_download(reference)
    from huggingface_hub import snapshot_download

    name, _, revision = reference.partition("@")
    try:
        return Path(snapshot_download(name, revision=revision or None, allow_patterns=[WEIGHTS, METADATA_FILE]))
    except Exception as error:  # the hub's client also raises errors of its transport and of the system
        raise CheckpointError(
            f"expected a folder or hub id, got '{reference}', which is no folder: {first_line(error)}"
        ) from None
