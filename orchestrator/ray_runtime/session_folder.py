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

from robogauntlet.support.secret_variables import without_secrets

GRACE_S = 5.0
"""Time for Ray's processes to end by themselves after that which started them (s); its agents take a minute."""

END_S = 60.0
"""Time to end what is left of them and to remove the folder (s)."""


class SessionFolder:
    """Ray's logs and sockets, and the temporary files of a session's processes.

    `remove` removes it. If this process is killed before, another one ends what is left of Ray and removes it.
    """

    def __init__(self, path: Path) -> None:
        """Guard the folder at `path`."""
        self.path, self.temporary = path, path / "tmp"
        self.temporary.mkdir(exist_ok=True)
        self._guard = subprocess.Popen(
            [sys.executable, "-m", __spec__.name, str(path), str(os.getpid())],
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
