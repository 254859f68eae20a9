"""With what a run is made: commit, packages, machine."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path

from orchestrator.environments.environment import Tenant
from orchestrator.environments.homes import Homes
from results.run import EVERYWHERE, Provenance


def collect(tenants: Sequence[Tenant], homes: Homes, definitions: Mapping[str, str]) -> Provenance:
    """The provenance of a run of these simulators and kinds of policies, with versions of each where it runs.

    Args:
        tenants: Simulators and kinds of policies.
        homes: In which environment each of them runs.
        definitions: Task to the hash of the file that defines it.
    """
    records = {one.name: homes.record(one) for one in tenants}
    distributions = [name for one in tenants if homes.of(one) is None for name in one.distributions]
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
    """Output of git in the folder that this code runs from, or None outside a repository."""
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
