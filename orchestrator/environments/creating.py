"""Makes and removes environments. What was not finished is never taken for one."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
import uuid
import venv
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from filelock import FileLock, Timeout
from packaging.requirements import Requirement

from orchestrator.environments.environment import MARKER, RUNNING, Environment, EnvironmentProblem, root
from orchestrator.environments.source import DISTRIBUTION
from orchestrator.folders import explain

Say = Callable[[str], None]
"""Is told what is being done, a line at a time."""
WORKERS_NEED = frozenset(
    {"numpy", "scipy", "colour-science", "pydantic", "pyyaml", "psutil", "greenlet", "filelock", "pillow"}
    | {"imageio-ffmpeg", "pyarrow"}
)
"""Those of our own requirements that processes in an environment import, besides Ray; the command has more."""
_STEPS = ("Collecting ", "Downloading ", "Using cached ", "Building ", "Preparing ", "Installing ", "Resolved ")
_REASONS = ("ERROR:", "error:", "×", "╰─▶", "Caused by:")
_ASIDE = ("ERROR: ResolutionImpossible", "ERROR: No matching distribution")


def create(environment: Environment, say: Say, *, fresh: bool = False) -> bool:
    """Make an environment.

    It is made in a folder of its own, to which its name is pointed when it is complete: whatever interrupts this, what
    was there before remains, and what is half is never taken for an environment. The next call clears it away.

    Args:
        environment: Which.
        say: See `Say`.
        fresh: Whether to make one that is there anew.

    Returns:
        False if it was there.

    Raises:
        EnvironmentProblem: It cannot be made; the message says why in one line.
    """
    entry, folder = environment.entry, environment.folder
    if entry.interpreter is not None:
        raise EnvironmentProblem(f"{environment.name}: {entry.interpreter} is your own; nothing is to be made")
    if entry.python not in (None, RUNNING):
        raise EnvironmentProblem(
            f"{environment.name}: expected Python {RUNNING} as here, which Ray asks of all its workers, "
            f"got python: {entry.python}"
        )
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with _alone(folder):
            if environment.made is not None and not fresh:
                return False
            _clear(folder, but=folder.resolve())
            making = folder.with_name(f".{folder.name}.{uuid.uuid4().hex[:8]}")
            try:
                _build(environment, making, say)
                _point(folder, making)
            finally:  # the old one, or what was made of the new one
                _clear(folder, but=folder.resolve())
    except OSError as error:
        raise EnvironmentProblem(f"{environment.name}: {folder.parent}: {explain(error)}") from None
    return True


def remove(name: str) -> list[Path]:
    """Remove all environments that were made under a name, or begun; returns their folders.

    Raises:
        EnvironmentProblem: One is being made, or cannot be removed.
    """
    folders = [folder for folder in all_folders() if folder.name.rpartition("-")[0] == name]
    try:
        for folder in folders:
            with _alone(folder):
                folder.unlink(missing_ok=True)
                _clear(folder)
            _lock_of(folder).unlink(missing_ok=True)
    except OSError as error:
        raise EnvironmentProblem(f"{name}: {root()}: {explain(error)}") from None
    return folders


def all_folders() -> list[Path]:
    """Folders of all environments that were made here or begun, sorted."""
    try:
        names = [one.name for one in root().iterdir() if one.is_dir()]
    except OSError:
        return []
    whole = {name for name in names if not name.startswith(".")}
    begun = {name[1:].rpartition(".")[0] for name in names if name.startswith(".")} - {""}
    return [root() / name for name in sorted(whole | begun)]


def _point(folder: Path, made: Path) -> None:
    """Have an environment's name stand for what was made, at once and wholly."""
    link = made.with_name(f"{made.name}.link")
    link.symlink_to(made.name)
    link.replace(folder)


def _clear(folder: Path, but: Path | None = None) -> None:
    """Remove what was made for an environment, but for one folder."""
    for one in folder.parent.glob(f".{folder.name}.*"):
        if one.is_symlink():
            one.unlink()
        elif one.is_dir() and one != but:
            shutil.rmtree(one)


def _lock_of(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.lock")


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    lock = FileLock(_lock_of(folder))
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise EnvironmentProblem(f"{folder}: another process is making it; wait for it") from None
    try:
        yield
    finally:
        lock.release()


def _build(environment: Environment, folder: Path, say: Say) -> None:
    entry = environment.entry
    has_pip = find_spec("pip") is not None
    say(f"a Python {RUNNING} in {environment.folder}")
    venv.EnvBuilder(symlinks=True, with_pip=not has_pip).create(folder)
    own = folder / "lib" / f"python{RUNNING}" / "site-packages"
    if entry.inherit:
        behind = [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
        line = f"import site; list(map(site.addsitedir, {behind!r}))\n"
        (own / "robogauntlet_inherited.pth").write_text(line, encoding="utf-8")
    held = folder / "constraints.txt"
    held.write_text(f"ray=={metadata.version('ray')}\n", encoding="utf-8")
    first = [*entry.requirements, *([] if entry.inherit else _for_workers())]
    for options, wanted in (["-c", str(held)], first), (["--no-deps"], list(entry.without_dependencies)):
        if wanted:
            say(f"installing {', '.join(wanted)}")
            _install(
                environment,
                [*_installer(environment, folder / "bin" / "python", has_pip=has_pip), *options, *wanted],
                say,
            )
    marker = {
        "name": environment.name,
        "entry": entry.model_dump(mode="json", exclude_defaults=True),
        "python": RUNNING,
        "inherits": sys.prefix if entry.inherit else None,
        "made_at": time.time(),
    }
    (folder / MARKER).write_text(json.dumps(marker, indent=1), encoding="utf-8")


def _for_workers() -> list[str]:
    """What an environment needs that inherits nothing."""
    ours = [Requirement(text) for text in metadata.requires(DISTRIBUTION) or ()]
    needed = [f"{one.name}{one.specifier}" for one in ours if one.marker is None and one.name.lower() in WORKERS_NEED]
    return [f"ray=={metadata.version('ray')}", *needed]


def _installer(environment: Environment, python: Path, *, has_pip: bool) -> list[str]:
    if environment.entry.installer == "uv":
        if (uv := shutil.which("uv")) is None:
            raise EnvironmentProblem(f"{environment.name}: expected uv on the PATH, there is none; or installer: pip")
        return [uv, "pip", "install", "--no-progress", "--python", str(python)]
    pip = [sys.executable, "-m", "pip", "--python", str(python)] if has_pip else [str(python), "-m", "pip"]
    return [*pip, "--disable-pip-version-check", "--no-input", "install", "--progress-bar", "off"]


def _install(environment: Environment, command: Sequence[str], say: Say) -> None:
    """Run an installer; what it says is passed on, and its reason told if it fails."""
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    said: list[str] = []
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", env=alone
    ) as process:
        try:
            assert process.stdout is not None
            for line in process.stdout:
                said.append(line.strip())
                if said[-1].startswith(_STEPS):
                    say(said[-1])
        except BaseException:
            process.kill()
            raise
    if process.returncode:
        raise EnvironmentProblem(f"{environment.name}: {reason(said)}")


def reason(said: Sequence[str]) -> str:
    """The line of an installer that says why."""
    for line in said:
        if "No space left on device" in line:
            return "the disk is full; free some space and create it again"
    reasons = [line for line in said if line.startswith(_REASONS) and not line.startswith(_ASIDE)]
    last = reasons[-1] if reasons else next((line for line in reversed(said) if line), "no message")
    return f"expected to install it, the installer says: {last.removeprefix('ERROR: ').removeprefix('Caused by: ')}"
