"""Checks whether an environment suits its simulator or policy, by running its Python before anything starts."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.requirements import InvalidRequirement, Requirement

from robogauntlet.adapters.contract import Simulator
from robogauntlet.orchestrator.environments import introspect
from robogauntlet.orchestrator.environments.environment import (
    RUNNING,
    WORKER_PACKAGES,
    Environment,
    EnvironmentUser,
    assets_variables,
    read_config,
)
from robogauntlet.orchestrator.environments.source_path import PACKAGE, import_path, source_file
from robogauntlet.support.child_process import ChildEnded, ChildTimeout, JsonChild
from robogauntlet.support.errors import last_line
from robogauntlet.support.secret_variables import without_secrets

TIME_LIMIT_S, READING_LIMIT_S = 60.0, 600.0
"""For an answer about versions, and for one about the contents of files (s)."""


@dataclass(frozen=True)
class EnvironmentCheck:
    """The installed versions and the problems of an environment."""

    problems: tuple[str, ...]
    """Why it cannot be used, a line each: what was expected, what is installed, what to do."""
    python: str = ""
    """Its version of Python."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Installed versions of Ray and of the requested distributions."""

    @property
    def problem(self) -> str | None:
        """All problems in one line, or None."""
        return "; ".join(self.problems) or None


def check(environment: Environment, user: EnvironmentUser, *, contents: bool = False) -> EnvironmentCheck:
    """Compare an environment with its entry and the requirements of its user.

    Workers run in a simulator's environment, so it is also compared with the running one. A policy's own interpreter
    only computes what its parent asks for: its Python need not agree, and it needs no Ray.

    With `contents`, also import what workers and the user import, and compare the files of required distributions with
    the hashes that their wheels state, which takes a second for a few hundred megabytes.
    """
    label, entry = f"environment {environment.name}", environment.entry
    remedy = f"create it: robogauntlet env create {environment.name}"
    if environment.manifest is None:
        if entry.interpreter is not None:
            return EnvironmentCheck((f"{label}: expected a Python interpreter at {environment.python}, found none",))
        return EnvironmentCheck((f"{label} does not exist; {remedy}",))
    remedy = "install it there" if entry.interpreter is not None else f"{remedy} --fresh"
    has_workers = isinstance(user, Simulator)
    if has_workers and entry.python not in (None, RUNNING):
        return EnvironmentCheck((_other_python(label, entry.python or ""),))
    wanted = tuple(named_requirements(*entry.requirements, *entry.without_dependencies))
    distributions = dict.fromkeys(["ray", *user.distributions, *(requirement.name for requirement in wanted)])
    python, modules = environment.python, user.modules
    if has_workers:
        modules += (*WORKER_PACKAGES.values(), PACKAGE)
    try:
        request = Request(modules, tuple(distributions))
        if contents:
            compared = tuple(requirement.name for requirement in wanted)
            imports = (user.imports,) if user.imports else user.modules
            if has_workers:
                imports = (*WORKER_PACKAGES.values(), *imports)
            request = replace(request, imports=imports, compared=compared)
        variables: tuple[tuple[str, str], ...] = ()
        if isinstance(user, Simulator):
            variables = tuple({**user.environment, **assets_variables(read_config())}.items())
        installed = _ask(python, python.lstat().st_mtime_ns, request, import_path(), variables)
    except (OSError, ChildEnded, ChildTimeout, ValueError) as error:
        return EnvironmentCheck((f"{label}: expected an answer from {python}, got: {last_line(error)}; {remedy}",))
    versions = {name: version for name, version in installed["versions"].items() if version is not None}
    if has_workers and installed["python"].rpartition(".")[0] != RUNNING:
        problems = [_other_python(label, installed["python"])]
    else:
        lacking = list(_problems(installed["modules"], versions, user, wanted))
        if not lacking:  # else imports fail for these reasons
            lacking += [f"expected to import what {user.name} needs, got {found}" for found in installed["imports"][:1]]
        lacking += _damage(installed["differing"])
        problems = [f"{label}: {problem}; {remedy}" for problem in lacking]
    return EnvironmentCheck(tuple(problems), installed["python"], versions)


def _problems(
    modules: Mapping[str, str | None], versions: Mapping[str, str], user: EnvironmentUser, wanted: Sequence[Requirement]
) -> Iterator[str]:
    needed = {f"modules of {user.name}": user.modules}
    if isinstance(user, Simulator):
        ray, its_ray = metadata.version("ray"), versions.get("ray")
        if its_ray != ray:
            yield f"expected Ray {ray} as here, it has {its_ray or 'none'}"
        source, its_source = source_file(PACKAGE), modules[PACKAGE]
        if its_source != source:
            yield f"expected RoboGauntlet from {source}, it imports {its_source or 'none'}"
        needed = {"packages of workers": tuple(WORKER_PACKAGES.values()), **needed}
    for what, names in needed.items():
        if missing := [name for name in names if modules[name] is None]:
            yield f"expected the {what}, it lacks {', '.join(missing)}"
    for requirement in wanted:
        version = versions.get(requirement.name)
        if version is None or not requirement.specifier.contains(version, prereleases=True):
            yield f"expected {requirement}, it has {version or 'none'}"


def _damage(differing: Mapping[str, Sequence[str]]) -> Iterator[str]:
    for distribution, files in differing.items():
        if files:
            more = f" and {len(files) - 1:,} more" if len(files) > 1 else ""
            yield f"expected the files of {distribution} as its wheel has them, {files[0]}{more} are missing or differ"


def _other_python(label: str, python: str) -> str:
    return f"{label}: expected Python {RUNNING} as here, which Ray requires of all workers, it has {python}"


def named_requirements(*texts: str) -> Iterator[Requirement]:
    """Requirements that name a distribution and apply to this Python; URLs and folders are omitted."""
    for text in texts:
        try:
            requirement = Requirement(text)
        except InvalidRequirement:
            continue
        if requirement.marker is None or requirement.marker.evaluate():
            yield requirement


@dataclass(frozen=True)
class Request:
    """What `introspect` is asked."""

    modules: tuple[str, ...]
    """Modules whose files are looked for."""
    distributions: tuple[str, ...]
    """Distributions whose versions are looked up."""
    imports: tuple[str, ...] = ()
    """Modules that are imported, or `MODULE:FUNCTION` that are called."""
    compared: tuple[str, ...] = ()
    """Distributions whose files are compared with their wheels."""


@lru_cache(maxsize=64)
def _ask(
    python: Path, changed_ns: int, request: Request, python_path: str, variables: tuple[tuple[str, str], ...]
) -> dict[str, Any]:
    """What `introspect` answers there; cached until the environment is created again (`changed_ns`)."""
    command = [str(python), "-c", Path(introspect.__file__).read_text(encoding="utf-8")]
    environment = {**dict(variables), **without_secrets(os.environ), "PYTHONPATH": python_path}
    with JsonChild(command, environment=environment) as child:
        limit_s = READING_LIMIT_S if request.compared or request.imports else TIME_LIMIT_S
        answer: dict[str, Any] = child.ask(asdict(request), limit_s)
        return answer
