"""Hidden folders in which runs from elsewhere and exported files arrive. The next arrival removes those of the dead."""

from __future__ import annotations

import contextlib
import secrets
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from robogauntlet.support.files import exclusive

PREFIX = ".arriving-"
LOCK_FILE = ".lock"
GRACE_S = 60.0
"""Age below which a folder is left alone, since its process may not have locked it yet (s)."""


@contextlib.contextmanager
def arriving_folder(root: Path) -> Iterator[Path]:
    """A new hidden folder under `root`, for the files of one arrival. It is removed when the block ends.

    If the block raises, folders that were created on the way to `root` are removed as well.

    Raises:
        OSError: It cannot be written.
    """
    created = [folder for folder in (root, *root.parents) if not folder.exists()]
    root.mkdir(parents=True, exist_ok=True)
    remove_abandoned(root)
    folder = root / f"{PREFIX}{secrets.token_hex(8)}"
    folder.mkdir()
    try:
        with exclusive(folder / LOCK_FILE, FileExistsError(folder)):
            yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        with contextlib.suppress(OSError):  # another process may be using it already
            for parent in created:
                parent.rmdir()
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def arriving_file(file: Path) -> Iterator[Path]:
    """A path for a new file, which is moved to its own place when the block succeeds.

    What a killed process leaves of it is removed when the next one arrives.

    Raises:
        OSError: It cannot be written.
    """
    with arriving_folder(file.parent) as folder:
        partial = folder / file.name
        yield partial
        partial.rename(file)


def remove_abandoned(root: Path) -> None:
    """Remove the folders of processes that died. What cannot be removed stays."""
    for folder in root.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):  # it has just gone, or belongs to somebody else
            if time.time() - folder.stat().st_mtime < GRACE_S:
                continue
            with exclusive(folder / LOCK_FILE, BlockingIOError(folder)):
                shutil.rmtree(folder, ignore_errors=True)
