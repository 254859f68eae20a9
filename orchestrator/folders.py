"""Folders that one process writes into at a time, and what is said when that cannot be."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from filelock import FileLock, Timeout

from results.run import RUN_FILE

LOCK_FILE = ".lock"


class FolderError(Exception):
    """The run folder cannot be used; the message says why."""


@contextlib.contextmanager
def locked(folder: Path, *, for_run: bool = False) -> Iterator[None]:
    """The folder, made if need be, for this process alone.

    Args:
        folder: To write into.
        for_run: Whether a run is played into it. Nothing else is written into the folder of a run.

    Raises:
        FolderError: It cannot be written, another process writes into it, or it holds a run.
    """
    if not for_run and (folder / RUN_FILE).exists():
        raise FolderError(f"{folder}: expected another folder than that of a run; give one with --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK_FILE)
        lock.acquire(timeout=0)
    except Timeout:
        raise FolderError(f"{folder}: another process runs into this folder") from None
    except OSError as error:
        raise FolderError(f"{folder}: {explain(error)}") from None
    try:
        yield
    finally:
        lock.release()


def explain_at(error: OSError, folder: Path) -> str:
    """An error while a folder was being written, with the place; what was read elsewhere is named instead."""
    place = Path(error.filename).absolute() if isinstance(error.filename, str | os.PathLike) else folder.absolute()
    if place.is_relative_to(folder.absolute()):
        return f"{folder}: {explain(error)}"
    return f"{error.filename}: {error.strerror}"


def explain(error: BaseException) -> str:
    """An error in words that say what to do."""
    if isinstance(error, OSError) and error.errno:
        hints: Mapping[int, str] = {
            errno.ENOSPC: "the disk is full; free some space and run again",
            errno.EROFS: "the file system is read-only; choose another folder with --out",
            errno.EACCES: "no permission to write; choose another folder with --out",
            errno.EEXIST: "expected a folder, this is a file",
            errno.ENOTDIR: "expected a folder, this is a file",
        }
        return hints.get(error.errno, os.strerror(error.errno))
    return str(error)
