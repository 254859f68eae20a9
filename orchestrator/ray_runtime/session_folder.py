"""The folder of Ray's session on this machine, with all temporary files; it goes with the process that started Ray."""

from __future__ import annotations

import contextlib
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil

GRACE_S = 5.0
"""Time for Ray's processes to end by themselves after that which started them (s); its agents take a minute."""


class SessionFolder:
    """Ray's logs and sockets, and the temporary files of a session's processes.

    `remove` removes it. If this process is killed before, another one ends what is left of the session and removes it.
    """

    def __init__(self, path: Path) -> None:
        """Guard the folder at `path`."""
        self.path, self.temporary = path, path / "tmp"
        self.temporary.mkdir(exist_ok=True)
        self._guard = subprocess.Popen(
            [sys.executable, "-m", __spec__.name, str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def remove(self) -> None:
        """Remove the folder, after Ray has ended."""
        self.keep()
        shutil.rmtree(self.path, ignore_errors=True)

    def keep(self) -> None:
        """Leave the folder, with Ray's logs in it."""
        self._guard.kill()
        self._guard.communicate()


def guard(path: Path) -> None:
    """Wait until standard input is closed, end the processes of the session at `path`, and remove it."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    sys.stdin.buffer.read()
    deadline = time.monotonic() + GRACE_S
    while (left := _writers(path)) and time.monotonic() < deadline:
        time.sleep(0.5)
    for process in left:
        with contextlib.suppress(psutil.Error):
            process.kill()
    psutil.wait_procs(left, GRACE_S)
    shutil.rmtree(path, ignore_errors=True)


def _writers(folder: Path) -> list[psutil.Process]:
    """The processes that write files of the folder, as all of Ray write their logs, whoever is their parent now."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if any(file.mode != "r" and Path(file.path).is_relative_to(folder) for file in process.open_files()):
                found.append(process)
    return found


if __name__ == "__main__":
    guard(Path(sys.argv[1]))
