"""Folders of assets that the user has: a variable for each simulator names one. Nothing is ever downloaded."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from robogauntlet.adapters.contract import AdapterError


def variable(simulator: str) -> str:
    """Return the environment variable with a simulator's folder, which workers get from the configuration too."""
    return f"ROBOGAUNTLET_{simulator.upper().replace('-', '_')}_ASSETS"


def named_folder(simulator: str) -> Path | None:
    """Return the folder that the user named for a simulator, whatever is there; None if none is named."""
    named = os.environ.get(variable(simulator))
    return Path(named).expanduser() if named else None


def what_lacks(folder: Path, needed: Iterable[str]) -> str | None:
    """Return in words what a folder lacks of the files or folders in it that are needed, None if it has all."""
    if not folder.is_dir():
        return f"{folder} {'is a file, expected a folder' if folder.exists() else 'does not exist'}"
    missing = [name for name in needed if not (folder / name).exists()]
    more = f" and {len(missing) - 1:,} more" if len(missing) > 1 else ""
    return f"{folder} lacks {missing[0]}{more}" if missing else None


@cache
def content_hash(folder: Path, parts: tuple[str, ...] = ("",)) -> str:
    """Hash the names and contents of all files in these parts of a folder, as 8 hexadecimal digits.

    It is read once in a process.

    Raises:
        AdapterError: A file cannot be read.
    """
    found = hashlib.sha256()
    try:
        for path in (path for part in parts for path in _files(folder / part)):
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            found.update(f"{path.relative_to(folder).as_posix()} {digest}\n".encode())
    except OSError as error:
        raise AdapterError(f"assets: {error.filename}: {error.strerror}") from None
    return found.hexdigest()[:8]


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder in one order, also those behind links, of which one to a folder above is left."""
    seen = set()
    for place, folders, names in os.walk(folder, followlinks=True):
        folders[:] = [] if (real := os.path.realpath(place)) in seen else sorted(folders)
        if real not in seen:
            yield from (Path(place, name) for name in sorted(names))
        seen.add(real)
