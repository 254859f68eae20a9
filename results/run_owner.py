"""Tells runs that this user played from folders that came from elsewhere: copied, unpacked or imported.

A run folder states what to import, contact and start. Only the user's own word for that is taken: a mark in the folder,
made with a key that never leaves the user's machine, of this run, what it plays and this place.
"""

from __future__ import annotations

import hmac
import json
import os
import secrets
from pathlib import Path

from platformdirs import user_state_path

from robogauntlet.results.run_document import RunDocument
from robogauntlet.support.files import RefusedFile, read_regular, write_whole

MARK_FILE = "played-here"
"""File in a run folder with its mark."""
KEY_FILE = "run-key"
KEY_BYTES = 32


def mark_as_own(folder: Path, document: RunDocument) -> bool:
    """Mark a run that this user plays; `is_own` is true from then on, in this folder and for these policies.

    Return whether it could be marked: not without a folder for the user's state that can be written.

    Raises:
        OSError: The run folder cannot be written.
    """
    if (key := _key(create=True)) is None:
        return False
    write_whole(folder / MARK_FILE, _mark(key, folder, document) + "\n")
    return True


def is_own(folder: Path, document: RunDocument) -> bool:
    """Return whether this user played the run in this folder, with the policies and environments of the document."""
    key = _key(create=False)
    if key is None or document.origin != "local":
        return False
    try:
        mark = read_regular(folder / MARK_FILE, 1000).decode("ascii").strip()
    except (OSError, RefusedFile, ValueError):
        return False
    return hmac.compare_digest(mark.encode(), _mark(key, folder, document).encode())


def _mark(key: bytes, folder: Path, document: RunDocument) -> str:
    suite = document.suite
    chosen = {
        "run_id": document.run_id,
        "folder": os.path.realpath(folder),
        "policies": [entry.model_dump(mode="json") for entry in suite.policies],
        "environments": {name: entry.model_dump(mode="json") for name, entry in suite.environments.items()},
        "suite_text": document.suite_text,
        "arguments": document.arguments and document.arguments.model_dump(mode="json"),
    }
    return hmac.new(key, json.dumps(chosen, sort_keys=True).encode(), "sha256").hexdigest()


def _key(*, create: bool) -> bytes | None:
    """The user's key; None if there is none, or none that only this user can have written and read."""
    path = user_state_path("robogauntlet") / KEY_FILE
    try:
        if create and not path.exists():
            _create(path)
        found = path.lstat()
        if found.st_uid != os.getuid() or found.st_mode & 0o077:
            return None
        key = read_regular(path, KEY_BYTES)
    except (OSError, RefusedFile):
        return None
    return key if len(key) == KEY_BYTES else None


def _create(path: Path) -> None:
    """Write a new key whole, unless another process was first. Raises OSError."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(secrets.token_bytes(KEY_BYTES))
        os.link(temporary, path)
    except FileExistsError:
        pass
    finally:
        temporary.unlink(missing_ok=True)
