"""Locks of folders, so that one process at a time writes into each."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from robogauntlet.results.run_document import RUN_FILE
from robogauntlet.support.errors import describe_os_error
from robogauntlet.support.files import exclusive

LOCK_FILE = ".lock"


class FolderError(Exception):
    """The run folder cannot be used; the message says why."""


@contextlib.contextmanager
def lock_folder(folder: Path, *, for_run: bool = False) -> Iterator[None]:
    """Create a folder if necessary, and hold its lock during the block. Run folders are locked with `for_run` only.

    A block that fails before it has written anything leaves no folder and no lock file that were not there before.

    Raises:
        FolderError: It cannot be written, another process writes into it, or it is a run folder.
    """
    if not for_run and (folder / RUN_FILE).exists():
        raise FolderError(f"{folder}: expected a folder that is not a run folder; give one with --out")
    lock = folder / LOCK_FILE
    with contextlib.ExitStack() as held:
        try:
            had_lock, missing = lock.exists(), [path for path in (folder, *folder.parents) if not path.exists()]
            folder.mkdir(parents=True, exist_ok=True)
            refusal = FolderError(f"{folder}: another process runs into this folder")
            held.enter_context(exclusive(lock, refusal))
        except OSError as error:
            raise FolderError(f"{folder}: {describe_os_error(error)}") from None
        before = set(folder.iterdir())
        try:
            yield
        except Exception:
            if not had_lock and set(folder.iterdir()) == before:
                lock.unlink()
                _remove_empty(missing)
            raise


def _remove_empty(folders: Sequence[Path]) -> None:
    """Remove folders, the innermost first, up to one that is not empty."""
    with contextlib.suppress(OSError):
        for folder in folders:
            folder.rmdir()
