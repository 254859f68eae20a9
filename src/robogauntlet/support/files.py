"""Files that may be anybody's, atomically written files and folders, and locks between processes."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import stat
import tempfile
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from filelock import FileLock, Timeout

LARGEST_DOCUMENT = 16_000_000
"""Bytes of a text that is read in one piece: JSON, metadata, source code."""
SMALLEST_CHECKED = 64_000_000
"""Bytes from which on a file with holes is looked at: reading less takes no time worth saving."""
MOST_HOLES = 0.9
"""Share of a large file that may be holes, which cost its sender nothing."""
MOST_EXTENTS = 10_000
"""Parts of a file that are looked at for holes."""
LOOK_S = 0.5
"""Time in which a look at a lock is over, also on a busy machine (s)."""
_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFDIR: "a folder",
}


class RefusedFile(OSError):
    """A file of others that is not read; the text, also in `strerror`, says what it is and does not name it."""

    def __init__(self, message: str, path: Path | None = None) -> None:
        super().__init__(message)
        self.strerror, self.filename = message, path and str(path)

    def __str__(self) -> str:
        return str(self.strerror)


def open_regular(path: Path, limit: int | None = None) -> BufferedReader:
    """Open a file of others for reading. It never waits, whatever is at the path.

    Args:
        path: The file, or a link to it.
        limit: Largest number of bytes, or None for any.

    Raises:
        RefusedFile: It is no regular file (a named pipe, a device, a folder), too large, or large
            and of holes.
        OSError: It cannot be read.
    """
    _check_regular(path.stat().st_mode, path)  # before it is opened: opening a device may do something
    opened = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0))
    file = os.fdopen(opened, "rb")
    try:
        state = os.fstat(opened)
        _check_regular(state.st_mode, path)
        if limit is not None and state.st_size > limit:
            raise _too_large(path, limit)
        if state.st_size > SMALLEST_CHECKED and _stored(opened, state.st_size) < (1 - MOST_HOLES) * state.st_size:
            raise RefusedFile(f"{state.st_size:,} bytes of holes", path)
    except BaseException:
        file.close()
        raise
    return file


def read_regular(path: Path, limit: int = LARGEST_DOCUMENT) -> bytes:
    """Return the content of a file of others. Raises OSError as `open_regular` does, also if it grows meanwhile."""
    with open_regular(path, limit) as file:
        content = file.read(limit + 1)
    if len(content) > limit:
        raise _too_large(path, limit)
    return content


def _check_regular(mode: int, path: Path) -> None:
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "something else")
        raise RefusedFile(f"{kind}, no regular file", path)


def _too_large(path: Path, limit: int) -> RefusedFile:
    return RefusedFile(f"more than {limit:,} bytes", path)


def _stored(file: int, size: int) -> int:
    """Bytes of an open file that are no holes; the rest counts in full after many parts, or if nobody knows."""
    stored = start = 0
    try:
        for _ in range(MOST_EXTENTS):
            start = os.lseek(file, start, os.SEEK_DATA)
            end = os.lseek(file, start, os.SEEK_HOLE)
            stored, start = stored + end - start, end
    except OSError as error:
        start = size if error.errno == errno.ENXIO else start  # ENXIO: no data follows
    finally:
        os.lseek(file, 0, os.SEEK_SET)
    return stored + size - start


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
        partial.unlink(missing_ok=True)  # it may be a link that somebody put there
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
        refusal: Raised if another process holds the lock, and does so for longer than `is_held` takes to look.

    Raises:
        OSError: The file cannot be created.
    """
    lock = FileLock(path)
    try:
        lock.acquire(timeout=LOOK_S, poll_interval=0.02)
    except Timeout:
        raise refusal from None
    try:
        yield
    finally:
        lock.release()


def is_held(path: Path) -> bool:
    """Whether a process holds a lock file by `exclusive`, or the file cannot be read. Looking keeps nobody from it."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False
