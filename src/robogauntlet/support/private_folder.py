"""Folders for temporary files that no other user of the machine can read or change."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

PRIVATE = 0o700
WRITABLE = 0o022
"""Permissions of others to change what is in a folder."""
SYSTEM_FOLDERS = ("/tmp", "/var/tmp")
"""Where temporary files may be if `TMPDIR` is too long for sockets."""
PREFIX = "rg"
"""First letters of a session's folder."""


class NoPrivateFolder(OSError):
    """There is no folder that only this user can use; the message is one line with the remedy."""


def private_folder(path: Path) -> Path:
    """Return a folder that only this user can open, and create it if necessary. Its parent must exist.

    A folder of this user that others could only read is closed to them.

    Raises:
        NoPrivateFolder: It belongs to another user, others could write into it, or it is a link.
        OSError: It cannot be created.
    """
    path.mkdir(mode=PRIVATE, exist_ok=True)
    found = os.lstat(path)
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & WRITABLE:
        raise NoPrivateFolder(
            f"{path}: expected a folder of this user that is closed to others (mode 0700), another user may have made "
            "it; remove it, or set TMPDIR"
        )
    path.chmod(PRIVATE)
    return path


def new_session_folder(longest: int) -> Path:
    """Return a new folder of this user alone whose path has at most `longest` characters, as sockets need.

    It is in the folder for temporary files (`TMPDIR`) or, if that path is too long or cannot be written, in one of the
    system's.

    Raises:
        NoPrivateFolder: None of these is suitable.
    """
    reasons = []
    for place in dict.fromkeys((tempfile.gettempdir(), *SYSTEM_FOLDERS)):
        room = longest - len(os.fsencode(place)) - len(f"/{PREFIX}") - len("12345678")
        if room < 0:
            reasons.append(f"{place} is too long by {-room}")
            continue
        try:
            return Path(tempfile.mkdtemp(prefix=PREFIX, dir=place))  # of mode 0700
        except OSError as error:
            reasons.append(f"{place}: {error.strerror}")
    raise NoPrivateFolder(
        f"expected a folder for Ray's sockets that can be written ({'; '.join(reasons)}); set TMPDIR to a folder of at "
        f"most {longest - len(f'/{PREFIX}12345678')} characters"
    )
