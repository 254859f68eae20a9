"""The folder of Ray's session on this machine, with all temporary files; it goes with the process that started Ray."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import psutil

from robogauntlet.support.private_folder import new_session_folder
from robogauntlet.support.secret_variables import without_secrets

SOCKET_BYTES = 107
"""Longest path of a socket on Linux."""
IN_FOLDER = "/ray/session_2026-01-01_00-00-00_000000_4194304/sockets/plasma_store"
"""Longest path of a socket in a session's folder."""
LONGEST = SOCKET_BYTES - len(IN_FOLDER)
"""Longest path of a session's folder."""
GRACE_S = 5.0
"""Time for Ray's processes to end by themselves after that which started them (s); its agents take a minute."""

END_S = 60.0
"""Time to end what is left of them and to remove the folder (s)."""


class SessionFolder:
    """Ray's logs and sockets, and the temporary files of a session's processes, in a folder of this user alone.

    Ray itself opens its folders to all users of the machine. `remove` removes it. If this process is killed before,
    another one ends what is left of Ray and removes it.
    """

    def __init__(self) -> None:
        """Create the folder.

        Raises:
            OSError: It cannot be created.
        """
        self.path = path = new_session_folder(LONGEST)
        self.ray, self.temporary = path / "ray", path / "tmp"
        self.temporary.mkdir()
        self._guard = subprocess.Popen(
            [sys.executable, "-P", "-m", __spec__.name, str(path), str(os.getpid())],
            env=without_secrets(os.environ),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def remove(self, *, logs: bool) -> None:
        """Remove the folder after Ray has ended, or its temporary files only, without Ray's logs."""
        self._guard.kill()
        self._guard.communicate()
        shutil.rmtree(self.path if logs else self.temporary, ignore_errors=True)


def guard(path: Path, owner: int) -> None:
    """Wait until the process `owner`, which holds standard input, has ended; end what is left of Ray, remove `path`."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    sys.stdin.buffer.read()
    deadline = time.monotonic() + GRACE_S
    while os.getppid() == owner:  # a process that is killed closes its files a little before it is gone
        if time.monotonic() > deadline:
            return  # it lives, and was interrupted where it would have removed the folder
        time.sleep(0.05)
    while (left := _writers(path)) and time.monotonic() < deadline:
        time.sleep(0.5)
    deadline += END_S
    while path.exists() and time.monotonic() < deadline:  # again, if a process has written while it was removed
        for process in left:
            with contextlib.suppress(psutil.Error):
                process.kill()
        psutil.wait_procs(left, GRACE_S)
        shutil.rmtree(path, ignore_errors=True)
        left = _writers(path) if path.exists() else []


def _writers(folder: Path) -> list[psutil.Process]:
    """The processes of Ray that write files of the folder, such as their logs, whoever is their parent now."""
    spec, found = find_spec("ray"), []
    package = str(Path(spec.origin).parent) if spec is not None and spec.origin is not None else "ray::"
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            words = process.cmdline()
            if not any(word.startswith(("ray::", package)) for word in words):
                continue
            is_named = any(str(folder) in word for word in words)  # most are, and their files need not be searched
            if is_named or any(file.mode != "r" and folder in Path(file.path).parents for file in process.open_files()):
                found.append(process)
    return found


if __name__ == "__main__":
    guard(Path(sys.argv[1]), int(sys.argv[2]))
