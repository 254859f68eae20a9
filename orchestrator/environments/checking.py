"""Does an environment fit: asked in it, before anything is started. Every mismatch is a line."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import metadata
from pathlib import Path

from packaging.requirements import InvalidRequirement, Requirement

from orchestrator.environments import inside
from orchestrator.environments.environment import RUNNING, Environment, Tenant
from orchestrator.environments.source import import_path, place_of

TIME_LIMIT_S = 60.0
NEEDED = ("numpy", "scipy", "colour", "pydantic", "yaml", "psutil", "greenlet", "filelock", "PIL", "imageio_ffmpeg")
"""Modules that workers import besides Ray, whatever simulator they have."""
OURS = "orchestrator"


@dataclass(frozen=True)
class Found:
    """What is in an environment."""

    problems: tuple[str, ...]
    """Why nothing can run there, a line each: what was expected, what came, what to do."""
    python: str = ""
    """Version of Python there."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Of Ray and of the distributions that were asked for, as installed there."""

    @property
    def problem(self) -> str | None:
        """What is wrong, in one line."""
        return "; ".join(self.problems) or None


@dataclass(frozen=True)
class _Told:
    """What an environment's own Python says."""

    python: str
    modules: Mapping[str, str | None]
    versions: Mapping[str, str | None]


def check(environment: Environment, tenant: Tenant) -> Found:
    """Hold an environment against the running one, against its entry, and against what its simulator needs."""
    named, entry = f"environment {environment.name}", environment.entry
    mend = f"make it: gauntlet env create {environment.name}"
    if environment.made is None:
        if entry.interpreter is not None:
            return Found((f"{named}: expected a Python at {environment.python}, there is none",))
        return Found((f"{named} is not there; {mend}",))
    mend = "install it there" if entry.interpreter is not None else f"{mend} --fresh"
    if entry.python not in (None, RUNNING):
        return Found((_other_python(named, entry.python or ""),))
    wanted = tuple(named_requirements(*entry.requirements, *entry.without_dependencies))
    distributions = dict.fromkeys(["ray", *tenant.distributions, *(one.name for one in wanted)])
    try:
        told = _ask(
            environment.python,
            environment.python.lstat().st_mtime_ns,
            (*tenant.modules, *NEEDED, OURS),
            tuple(distributions),
            import_path(),
        )
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        last = (str(getattr(error, "stderr", None) or error).strip().splitlines() or ["no message"])[-1]
        return Found((f"{named}: expected an answer from {environment.python}, got: {last}; {mend}",))
    versions = {name: version for name, version in told.versions.items() if version is not None}
    problems = tuple(f"{named}: {problem}" for problem in _problems(told, tenant, wanted, mend))
    if told.python.rpartition(".")[0] != RUNNING:
        problems = (_other_python(named, told.python),)
    return Found(problems, told.python, versions)


def _problems(told: _Told, tenant: Tenant, wanted: tuple[Requirement, ...], mend: str) -> Iterator[str]:
    ray = metadata.version("ray")
    if (there := told.versions.get("ray")) != ray:
        yield f"expected Ray {ray} as here, it has {there or 'none'}; {mend}"
    if (place := told.modules[OURS]) != place_of(OURS):
        yield f"expected RoboGauntlet from {place_of(OURS)}, it imports {place or 'none'}; {mend}"
    for what, names in (("what workers import", NEEDED), (f"the modules of {tenant.name}", tenant.modules)):
        if lacking := [name for name in names if told.modules[name] is None]:
            yield f"expected {what}, it lacks {', '.join(lacking)}; {mend}"
    for one in wanted:
        version = told.versions.get(one.name)
        if version is None or not one.specifier.contains(version, prereleases=True):
            yield f"expected {one}, it has {version or 'none'}; {mend}"


def _other_python(named: str, python: str) -> str:
    return f"{named}: expected Python {RUNNING} as here, which Ray asks of all its workers, it has {python}"


def named_requirements(*texts: str) -> Iterator[Requirement]:
    """Those that name a distribution, and hold for this Python; not those that are addresses or folders."""
    for text in texts:
        try:
            requirement = Requirement(text)
        except InvalidRequirement:
            continue
        if requirement.marker is None or requirement.marker.evaluate():
            yield requirement


@lru_cache(maxsize=64)
def _ask(
    python: Path, changed_ns: int, modules: tuple[str, ...], distributions: tuple[str, ...], python_path: str
) -> _Told:
    """What an environment's Python says; asked again when the environment was made anew (`changed_ns`)."""
    asked = json.dumps({"modules": modules, "distributions": distributions})
    done = subprocess.run(
        [str(python), "-c", Path(inside.__file__).read_text(encoding="utf-8"), asked],
        capture_output=True,
        text=True,
        timeout=TIME_LIMIT_S,
        env={**os.environ, "PYTHONPATH": python_path},
        check=True,
    )
    (answer,) = [line for line in done.stdout.splitlines() if line.startswith(inside.MARK)]
    return _Told(**json.loads(answer.removeprefix(inside.MARK)))
