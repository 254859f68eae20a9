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
    if os.getppid() == owner:
        return  # it lives, and was interrupted where it would have removed the folder
    deadline = time.monotonic() + GRACE_S
    while (left := _writers(path)) and time.monotonic() < deadline:
        time.sleep(0.5)
    for process in left:
        with contextlib.suppress(psutil.Error):
            process.kill()
    psutil.wait_procs(left, GRACE_S)
    shutil.rmtree(path, ignore_errors=True)


def _writers(folder: Path) -> list[psutil.Process]:
    """The processes of Ray that write files of the folder, such as their logs, whoever is their parent now."""
    spec, found = find_spec("ray"), []
    package = str(Path(spec.origin).parent) if spec is not None and spec.origin is not None else "ray::"
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if not any(part.startswith(("ray::", package)) for part in process.cmdline()):
                continue
            if any(file.mode != "r" and Path(file.path).is_relative_to(folder) for file in process.open_files()):
                found.append(process)
    return found


if __name__ == "__main__":
    guard(Path(sys.argv[1]), int(sys.argv[2]))
