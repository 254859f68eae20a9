"""The software and hardware that a run is made with."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path

from robogauntlet.orchestrator.environments.environment import EnvironmentUser
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.results.run_document import EVERYWHERE, Provenance


def collect(
    users: Sequence[EnvironmentUser], environments: EnvironmentResolver, definitions: Mapping[str, str]
) -> Provenance:
    """Collect the provenance of a run.

    Args:
        users: Simulators and kinds of policies; the versions are those in their environments.
        environments: The environment of each of them.
        definitions: Task to the hash of the file that defines it.
    """
    records = {user.name: environments.record(user) for user in users}
    distributions = [name for user in users if environments.resolve(user) is None for name in user.distributions]
    commit = _git("rev-parse", "HEAD")
    status = _git("status", "--porcelain", "--untracked-files=no")
    packages = {name: version for name in dict.fromkeys([*EVERYWHERE, *distributions]) if (version := _version(name))}
    return Provenance(
        git_commit=commit,
        git_dirty=bool(status) if status is not None else None,
        python=platform.python_version(),
        platform=platform.platform(),
        processor=_processor(),
        cores=os.cpu_count() or 0,
        packages=packages,
        environments={name: record for name, record in records.items() if record is not None},
        definitions=dict(definitions),
    )


def _git(*arguments: str) -> str | None:
    """Output of git in this code's folder, or None outside a repository."""
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=Path(__file__).parent, capture_output=True, text=True, timeout=20, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())
