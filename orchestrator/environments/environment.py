"""Which Python environment is meant, and where it lies. Looks, and makes nothing."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from adapters import catalog
from policies import catalog as policies
from suites.environments import Config, EnvironmentEntry
from suites.loading import load_config
from suites.vocabulary import content_hash

MARKER = "environment.json"
"""Written last: a folder without it is no environment."""
RUNNING = f"{sys.version_info.major}.{sys.version_info.minor}"


class EnvironmentProblem(Exception):
    """An environment that cannot be had; the message says why and what to do."""


class Tenant(Protocol):
    """What may live in an environment of its own: a simulator, or a kind of policy."""

    @property
    def name(self) -> str:
        """Its name, and its environment's."""

    @property
    def modules(self) -> tuple[str, ...]:
        """Import names that must be installed."""

    @property
    def distributions(self) -> tuple[str, ...]:
        """Distributions whose versions belong to the provenance of a result."""

    @property
    def requirements(self) -> tuple[str, ...]:
        """What pip installs for it."""

    @property
    def without_dependencies(self) -> tuple[str, ...]:
        """The same, without what these distributions name as their dependencies."""


@dataclass(frozen=True)
class Environment:
    """A Python environment, there or to be made."""

    name: str
    """Of the simulator that lives in it."""
    entry: EnvironmentEntry
    origin: str
    """Who says so: `the suite`, `its adapter`, or the configuration file."""

    @property
    def folder(self) -> Path:
        """Where it lies: another for another entry, another Python, and another environment that it inherits from."""
        made = [self.entry.hash, RUNNING, sys.prefix if self.entry.inherit else None]
        return root() / f"{self.name}-{content_hash(made, length=12)}"

    @property
    def python(self) -> Path:
        """Its interpreter."""
        if self.entry.interpreter is not None:
            return Path(self.entry.interpreter).expanduser()
        return self.folder / "bin" / "python"

    @property
    def made(self) -> Mapping[str, Any] | None:
        """What was written down when it was complete; None if it is not there. Empty for one that we did not make."""
        if self.entry.interpreter is not None:
            return {} if os.access(self.python, os.X_OK) else None
        try:
            return dict(json.loads((self.folder / MARKER).read_text(encoding="utf-8")))
        except (OSError, ValueError):
            return None


def tenants() -> dict[str, Tenant]:
    """What may have an environment of its own: simulators, and kinds of policies that ask for one."""
    kinds = {name: kind for name, kind in policies.kinds().items() if kind.requirements or kind.without_dependencies}
    return {**kinds, **catalog.simulators()}


def root() -> Path:
    """The folder with the environments: GAUNTLET_ENVIRONMENTS, or in the platform's folder for data."""
    if named := os.environ.get("GAUNTLET_ENVIRONMENTS"):
        return Path(named).expanduser().absolute()
    import platformdirs  # not in environments that inherit nothing, whose processes need not ask

    return platformdirs.user_data_path("robogauntlet") / "environments"


def config_path() -> Path:
    """The configuration file: GAUNTLET_CONFIG, or in the platform's folder for configurations."""
    if named := os.environ.get("GAUNTLET_CONFIG"):
        return Path(named).expanduser()
    import platformdirs

    return platformdirs.user_config_path("robogauntlet") / "config.yaml"


def read_config() -> Config:
    """What the user's configuration says; nothing if there is none.

    Raises:
        SuiteError: It is wrong, or GAUNTLET_CONFIG names none.
    """
    path = config_path()
    if not path.exists() and "GAUNTLET_CONFIG" not in os.environ:
        return Config()
    return load_config(path, sorted(tenants()))


def environment_of(
    tenant: Tenant, declared: Mapping[str, EnvironmentEntry], config: Config | None = None
) -> Environment | None:
    """The environment that is meant for a simulator, whether or not it is there; None for the running one.

    Args:
        tenant: The simulator.
        declared: What the suite says.
        config: What the user's configuration says; read if it is None.

    Raises:
        SuiteError: The configuration is wrong.
    """
    if tenant.name in declared:
        return Environment(tenant.name, declared[tenant.name], "the suite")
    configured = (read_config() if config is None else config).environments
    if tenant.name in configured:
        return Environment(tenant.name, configured[tenant.name], str(config_path()))
    return by_default(tenant)


def by_default(tenant: Tenant, *, anyway: bool = False) -> Environment | None:
    """The environment that a simulator comes with, where the running one lacks the simulator.

    Args:
        tenant: The simulator.
        anyway: Even where the running one has it.
    """
    if not (tenant.requirements or tenant.without_dependencies):
        return None
    if not anyway and all(find_spec(module) is not None for module in tenant.modules):
        return None
    entry = EnvironmentEntry(requirements=tenant.requirements, without_dependencies=tenant.without_dependencies)
    return Environment(tenant.name, entry, "its adapter")
