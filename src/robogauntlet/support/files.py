"""Atomically written files and folders, and locks between processes."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout


@contextlib.contextmanager
def replacing(target: Path, *, shared: bool = False) -> Iterator[Path]:
    """A path beside the target, moved onto it if the block succeeds and removed if it raises.

    Args:
        target: The file to write, in an existing folder. Readers see the old file or the new one.
        shared: Whether several processes may write it at once. If not, a killed process leaves at most one partial
            file, which the next process overwrites.

    Raises:
        OSError: The file cannot be written; the target is unchanged.
    """
    partial = target.with_name(f".{target.name}{f'.{os.getpid()}' if shared else ''}.partial")
    try:
        yield partial
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def write_whole(target: Path, content: str | bytes) -> None:
    """Write a small file atomically (text as UTF-8); see `replacing`."""
    with replacing(target, shared=True) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


@contextlib.contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """An empty folder beside the target, renamed to it if the block succeeds and removed if it raises.

    Raises:
        OSError: It cannot be written, or the target exists and is not empty.
    """
    with tempfile.TemporaryDirectory(prefix=f".{target.name}.partial-", dir=target.parent) as name:
        partial = Path(name) / target.name  # a subfolder, because mkdtemp restricts the permissions of its own
        partial.mkdir()
        yield partial
        partial.rename(target)


@contextlib.contextmanager
def exclusive(path: Path, refusal: Exception) -> Iterator[None]:
    """Hold a lock file during the block; the system releases it if this process dies.

    Args:
        path: The lock file, which is created if necessary.
        refusal: Raised if another process holds the lock.

    Raises:
        OSError: The file cannot be created.
    """
    lock = FileLock(path)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise refusal from None
    try:
        yield
    finally:
        lock.release()
