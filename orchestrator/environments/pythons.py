"""Finds a Python of another version on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from robogauntlet.orchestrator.environments.environment import RUNNING

SEARCHED = "on the PATH or in pyenv"
TIME_LIMIT_S = 20.0
_QUESTION = "import sys, venv; print('%d.%d' % sys.version_info[:2])"


def find_python(version: str) -> Path | None:
    """The running interpreter if it has this version (`3.12`), else the first `python3.12` that starts and has it.

    It is looked for on the PATH, then among pyenv's versions: pyenv's shim on the PATH fails unless one is activated.
    """
    if version == RUNNING:
        return Path(sys.executable)
    return next((path for path in _candidates(version) if _is(path, version)), None)


def _candidates(version: str) -> Iterator[Path]:
    for folder in os.get_exec_path():
        if os.access(path := Path(folder, f"python{version}"), os.X_OK):
            yield path
    pyenv = Path(os.environ.get("PYENV_ROOT") or "~/.pyenv").expanduser()
    yield from sorted(pyenv.glob(f"versions/{version}.*/bin/python{version}"))


def _is(python: Path, version: str) -> bool:
    try:
        asked = [str(python), "-c", _QUESTION]
        done = subprocess.run(asked, capture_output=True, text=True, timeout=TIME_LIMIT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0 and done.stdout.strip() == version
