"""Reads the files of a released checkpoint: tensors, none of which is copied into memory, and statistics."""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from robogauntlet.adapters.contract import ACTION_DIM, PROPRIOCEPTION_DIM
from robogauntlet.policies.stored import StoredError
from robogauntlet.support.errors import first_line
from robogauntlet.support.files import open_regular, read_regular
from robogauntlet.support.json_text import parse_json
from robogauntlet.support.text import visible
from robogauntlet_mergevla.checkpoints.expert_checkpoint import read_tensors
from robogauntlet_mergevla.network.normalisation import Quantiles, Statistics, StatisticsError, TaskStatistics
from robogauntlet_mergevla.released.names import released_names

SAFETENSORS, TORCH, STATISTICS = ".safetensors", ".pt", "dataset_statistics.json"
LARGEST_PICKLE = 4_000_000
"""Bytes of the list of a `.pt` file's tensors: twenty thousand fit, and each byte may stand for a hundred in memory."""
MOST_DICTIONARIES = 100
"""Dictionaries in a file, the whole and parts of the model by name; less deep than Python's recursion."""


class ReleasedError(StoredError):
    """A released checkpoint that cannot be imported."""


@dataclass(frozen=True, eq=False)
class ReleasedFiles:
    """What the files hold."""

    tensors: Mapping[str, Tensor]
    """By the names of `names.source_of`."""
    statistics: TaskStatistics | None
    """By the name of the data set, in the data set's own units; None without a file of them."""


def read_files(places: Sequence[Path]) -> ReleasedFiles:
    """Read files, and those in folders (not below), of a checkpoint.

    A `.pt` file is read by torch's own reader of plain tensors, which runs no code of the file. Raises ReleasedError
    for a file that cannot be read or holds anything else, or two files that hold the same tensor.
    """
    tensors: dict[str, Tensor] = {}
    origins: dict[str, Path] = {}
    statistics: TaskStatistics | None = None
    for path in _files(places):
        if path.name == STATISTICS:
            statistics = read_statistics(path)
            continue
        held = read_tensors(path) if path.suffix == SAFETENSORS else _read_torch(path)
        for given, name in released_names(held).items():
            if name in origins:
                raise ReleasedError(
                    f"expected each tensor once, got {name} in '{origins[name]}' and in '{path}'; leave one out"
                )
            tensors[name], origins[name] = held[given], path
    return ReleasedFiles(tensors, statistics)


def _files(places: Sequence[Path]) -> Iterator[Path]:
    for place in places:
        try:
            found = [path for path in sorted(place.iterdir()) if _is_read(path)] if place.is_dir() else [place]
            if not place.exists():
                raise ReleasedError(f"expected a folder or file of a released checkpoint, got '{place}'")
        except (OSError, ValueError) as error:
            raise ReleasedError(f"expected to read '{place}', got: {first_line(error)}") from None
        if not found:
            raise ReleasedError(f"expected *{SAFETENSORS} or *{TORCH} in '{place}', got a folder without any")
        for path in found:
            if not _is_read(path):
                raise ReleasedError(f"expected *{SAFETENSORS}, *{TORCH} or {STATISTICS}, got '{path}'")
            yield path


def _is_read(path: Path) -> bool:
    return path.suffix in (SAFETENSORS, TORCH) or path.name == STATISTICS


def _read_torch(path: Path) -> dict[str, Tensor]:
    _check_archive(path)
    try:
        content = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except pickle.UnpicklingError:
        raise ReleasedError(
            f"expected tensors alone in '{path}', got other objects: refused, since loading them runs code"
        ) from None
    except Exception as error:  # torch's reader raises whatever the damaged bytes lead to
        raise ReleasedError(f"expected a file of torch.save in '{path}', got: {first_line(error)}") from None
    if isinstance(content, dict) and isinstance(content.get("model"), dict):  # Prismatic's, beside the optimiser's
        content = content["model"]
    tensors = dict(_flat(path, content, "", set()))
    if not tensors:
        raise ReleasedError(f"expected tensors by name in '{path}', got {type(content).__name__}")
    return tensors


def _check_archive(path: Path) -> None:
    """Refuse what torch.save does not write: packed entries, which unfold to any size, and a pickle of millions."""
    try:
        with open_regular(path) as file:
            if not zipfile.is_zipfile(file):
                return  # torch's reader of mapped files refuses it at once
            with zipfile.ZipFile(file) as archive:
                entries = archive.infolist()
    except OSError as error:
        raise ReleasedError(f"expected to read '{path}', got: {error.strerror}") from None
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        raise ReleasedError(f"expected a file of torch.save in '{path}', got: {first_line(error)}") from None
    for entry in entries:
        shown = visible(entry.filename[:100])
        if entry.compress_type != zipfile.ZIP_STORED or entry.file_size != entry.compress_size:
            raise ReleasedError(
                f"expected a file of torch.save in '{path}', got {shown} packed to {entry.compress_size} bytes"
            )
        if entry.filename.endswith("data.pkl") and entry.file_size > LARGEST_PICKLE:
            raise ReleasedError(
                f"expected at most {LARGEST_PICKLE:,} bytes of names in '{path}', got {entry.file_size:,}"
            )


def _flat(path: Path, content: Any, prefix: str, seen: set[int]) -> Iterator[tuple[str, Tensor]]:
    """Tensors in dictionaries of dictionaries, their names joined by points.

    Raises ReleasedError for a dictionary that occurs twice, or within itself: a small file could stand for any number.
    """
    if isinstance(content, Tensor):
        yield prefix.removesuffix("."), content
    elif isinstance(content, dict):
        if id(content) in seen or len(seen) >= MOST_DICTIONARIES:
            raise ReleasedError(f"expected tensors by name in '{path}', got dictionaries that refer to each other")
        seen.add(id(content))
        for name, value in content.items():
            yield from _flat(path, value, f"{prefix}{name}.", seen)


def read_statistics(path: Path) -> TaskStatistics:
    """Read a released `dataset_statistics.json`: data set to `action` and `proprio`, each with `q01` and `q99`.

    Raises ReleasedError if it is malformed, or of anything but one data set of 7 numbers of action and 8 of
    proprioception.
    """
    try:
        plain = parse_json(read_regular(path))
        by_task = {
            str(name): Statistics(_quantiles(one["action"]), _quantiles(one["proprio"])) for name, one in plain.items()
        }
    except OSError as error:
        raise ReleasedError(f"expected to read '{path}', got: {error.strerror}") from None
    except StatisticsError as error:
        raise ReleasedError(f"'{path}': {error}") from None
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        problem = f"no {error}" if isinstance(error, KeyError) else first_line(error)
        raise ReleasedError(f"expected the statistics of a data set in '{path}', got: {problem}") from None
    for one in by_task.values():
        if (sizes := (len(one.action.q01), len(one.proprioception.q01))) != (ACTION_DIM, PROPRIOCEPTION_DIM):
            expected = f"{ACTION_DIM} numbers of action and {PROPRIOCEPTION_DIM} of proprioception"
            raise ReleasedError(f"'{path}': expected statistics of {expected}, got of {sizes[0]} and {sizes[1]}")
    if len(by_task) != 1:
        raise ReleasedError(f"expected the statistics of one data set in '{path}', got {', '.join(by_task) or 'none'}")
    return TaskStatistics(by_task)


def _quantiles(plain: Any) -> Quantiles:
    return Quantiles(tuple(map(float, plain["q01"])), tuple(map(float, plain["q99"])))
