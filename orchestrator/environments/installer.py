"""Creates and removes environments. An unfinished environment is never used."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from packaging.requirements import Requirement

from robogauntlet.orchestrator.environments.environment import (
    MARKER,
    RUNNING,
    WORKER_PACKAGES,
    Environment,
    EnvironmentProblem,
    root,
)
from robogauntlet.orchestrator.environments.pythons import SEARCHED, find_python
from robogauntlet.orchestrator.environments.source_path import PACKAGE
from robogauntlet.support.errors import describe_os_error
from robogauntlet.support.files import exclusive

Log = Callable[[str], None]
"""Called with a line for each step."""
_STEPS = ("Collecting ", "Downloading ", "Using cached ", "Building ", "Preparing ", "Installing ", "Resolved ")
_REASONS = ("ERROR:", "error:", "×", "╰─▶", "Caused by:")
_NO_REASONS = ("ERROR: ResolutionImpossible", "ERROR: No matching distribution")


def create(environment: Environment, log: Log, *, fresh: bool = False) -> bool:
    """Create an environment.

    It is created in a new folder; when it is complete, a link with its name points to the folder. After an
    interruption the earlier environment remains, and the next call removes the unfinished one.

    Args:
        environment: The environment.
        log: See `Log`.
        fresh: Whether to replace an existing environment.

    Returns:
        False if it existed already.

    Raises:
        EnvironmentProblem: It cannot be created; the message says why in one line.
    """
    entry, folder = environment.entry, environment.folder
    if entry.interpreter is not None:
        raise EnvironmentProblem(f"{environment.name}: {entry.interpreter} is your own interpreter; nothing to create")
    if environment.version != RUNNING and (environment.has_workers or entry.inherit):
        why = "which Ray requires of all workers" if environment.has_workers else "or inherit: false"
        raise EnvironmentProblem(
            f"{environment.name}: expected Python {RUNNING} as here, {why}, got python: {entry.python}"
        )
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with _locked(folder):
            if environment.manifest is not None and not fresh:
                return False
            _clear(folder, but=folder.resolve())
            unfinished = folder.with_name(f".{folder.name}.{uuid.uuid4().hex[:8]}")
            try:
                _build(environment, unfinished, log)
                link = unfinished.with_name(f"{unfinished.name}.link")
                link.symlink_to(unfinished.name)
                link.replace(folder)  # atomic
            finally:  # removes the old folder, or the unfinished new one
                _clear(folder, but=folder.resolve())
    except OSError as error:
        raise EnvironmentProblem(f"{environment.name}: {folder.parent}: {describe_os_error(error)}") from None
    return True


def remove(name: str) -> list[Path]:
    """Remove all environments of a name, finished or not, and return their folders. Raises EnvironmentProblem."""
    folders = [folder for folder in all_folders() if folder.name.rpartition("-")[0] == name]
    try:
        for folder in folders:
            with _locked(folder):
                folder.unlink(missing_ok=True)
                _clear(folder)
            folder.with_name(f".{folder.name}.lock").unlink(missing_ok=True)
    except OSError as error:
        raise EnvironmentProblem(f"{name}: {root()}: {describe_os_error(error)}") from None
    return folders


def all_folders() -> list[Path]:
    """Folders of all finished and unfinished environments on this machine, sorted."""
    try:
        names = [folder.name for folder in root().iterdir() if folder.is_dir()]
    except OSError:
        return []
    whole = {name for name in names if not name.startswith(".")}
    begun = {name[1:].rpartition(".")[0] for name in names if name.startswith(".")} - {""}
    return [root() / name for name in sorted(whole | begun)]


def _clear(folder: Path, but: Path | None = None) -> None:
    """Remove all folders of an environment except one."""
    for path in folder.parent.glob(f".{folder.name}.*"):
        if path.is_symlink():
            path.unlink()
        elif path.is_dir() and path != but:
            shutil.rmtree(path)


def _locked(folder: Path) -> AbstractContextManager[None]:
    lock = folder.with_name(f".{folder.name}.lock")
    return exclusive(lock, EnvironmentProblem(f"{folder}: another process is creating it; wait for it"))


def _build(environment: Environment, folder: Path, log: Log) -> None:
    entry = environment.entry
    has_pip = find_spec("pip") is not None
    if (python := find_python(environment.version)) is None:
        raise EnvironmentProblem(f"{environment.name}: no Python {environment.version} that starts is {SEARCHED}")
    log(f"a Python {environment.version} in {environment.folder}")
    _run(environment, [str(python), "-m", "venv", *(["--without-pip"] if has_pip else []), str(folder)], log)
    site_packages = folder / "lib" / f"python{environment.version}" / "site-packages"
    if entry.inherit:
        inherited = [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
        line = f"import site; list(map(site.addsitedir, {inherited!r}))\n"
        (site_packages / "robogauntlet_inherited.pth").write_text(line, encoding="utf-8")
    constraints, first = folder / "constraints.txt", list(entry.requirements)
    constraints.write_text(f"ray=={metadata.version('ray')}\n", encoding="utf-8")
    if environment.has_workers and not entry.inherit:
        first += _worker_requirements()
    for options, wanted in (["-c", str(constraints)], first), (["--no-deps"], list(entry.without_dependencies)):
        if wanted:
            log(f"installing {', '.join(wanted)}")
            command = _installer(environment, folder / "bin" / "python", has_pip=has_pip)
            _run(environment, [*command, *options, *wanted], log)
    marker = {
        "name": environment.name,
        "entry": entry.model_dump(mode="json", exclude_defaults=True),
        "python": environment.version,
        "inherits": sys.prefix if entry.inherit else None,
        "made_at": time.time(),
    }
    (folder / MARKER).write_text(json.dumps(marker, indent=1), encoding="utf-8")


def _worker_requirements() -> list[str]:
    """Requirements of workers in an environment that inherits nothing."""
    ours = [requirement for requirement in map(Requirement, metadata.requires(PACKAGE) or ()) if not requirement.marker]
    needed = [f"{item.name}{item.specifier}" for item in ours if item.name.lower() in WORKER_PACKAGES]
    return [f"ray=={metadata.version('ray')}", *needed]


def _installer(environment: Environment, python: Path, *, has_pip: bool) -> list[str]:
    if environment.entry.installer == "uv":
        if (uv := shutil.which("uv")) is None:
            remedy = "install uv or write installer: pip"
            raise EnvironmentProblem(f"{environment.name}: expected uv on the PATH, found none; {remedy}")
        return [uv, "pip", "install", "--no-progress", "--python", str(python)]
    pip = [sys.executable, "-m", "pip", "--python", str(python)] if has_pip else [str(python), "-m", "pip"]
    return [*pip, "--disable-pip-version-check", "--no-input", "install", "--progress-bar", "off"]


def _run(environment: Environment, command: Sequence[str], log: Log) -> None:
    """Run an installer or `venv`, log its steps, and raise the reason if it fails."""
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    lines: list[str] = []
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace", env=variables
    ) as process:
        try:
            assert process.stdout is not None
            for line in process.stdout:
                lines.append(line.strip())
                if lines[-1].startswith(_STEPS):
                    log(lines[-1])
        except BaseException:
            process.kill()
            raise
    if process.returncode:
        raise EnvironmentProblem(f"{environment.name}: {reason(lines)}")


def reason(lines: Sequence[str]) -> str:
    """The line of an installer's output with the reason of its failure."""
    for line in lines:
        if "No space left on device" in line:
            return "the disk is full; free some space and create it again"
    reasons = [line for line in lines if line.startswith(_REASONS) and not line.startswith(_NO_REASONS)]
    last = reasons[-1] if reasons else next((line for line in reversed(lines) if line), "no message")
    return f"the installer failed: {last.removeprefix('ERROR: ').removeprefix('Caused by: ')}"
