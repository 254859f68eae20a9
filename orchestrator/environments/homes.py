"""In which environment each simulator runs: what everything asks that opens simulators in other processes."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Mapping
from importlib import metadata
from typing import Any

from adapters import catalog
from adapters.contract import Simulator
from orchestrator.environments.checking import Found, check
from orchestrator.environments.environment import Environment, Tenant, environment_of, read_config
from orchestrator.environments.source import import_path
from orchestrator.worker_environment import worker_environment
from policies import catalog as policies
from policies.contract import PolicyError
from results.run import EnvironmentRecord
from suites.environments import Config, EnvironmentEntry


class Homes:
    """Where simulators live, by what a suite declares, by the user's configuration, and by what adapters come with."""

    def __init__(self, declared: Mapping[str, EnvironmentEntry] | None = None) -> None:
        """Args: declared: By the suite.

        Raises:
            SuiteError: The user's configuration is wrong.
        """
        self._declared: Mapping[str, EnvironmentEntry] = declared or {}
        self._config: Config = read_config()

    def of(self, tenant: Tenant) -> Environment | None:
        """The environment that a simulator runs in, whether or not it is there; None for the running one."""
        return environment_of(tenant, self._declared, self._config)

    def options(self, kind: str, options: Mapping[str, Any]) -> Mapping[str, Any]:
        """A policy's options, with the interpreter of the environment that it computes in, if it has one.

        Raises:
            PolicyError: The environment is not there, or does not fit.
        """
        found = policies.find(kind)
        if not (found.requirements or found.without_dependencies) or "python" in options:
            return options
        environment = self.of(found)
        if environment is None:
            return options
        if problem := check(environment, found).problem:
            raise PolicyError(problem)
        return {**options, "python": str(environment.python)}

    def found(self, simulator: Tenant) -> Found | None:
        """What is in its environment; None for the running one."""
        environment = self.of(simulator)
        return None if environment is None else check(environment, simulator)

    def missing_reason(self, simulator: Simulator) -> str | None:
        """Why the simulator cannot be opened, with the fix; None if nothing speaks against it. Imports nothing."""
        found = self.found(simulator)
        return catalog.missing_reason(simulator) if found is None else found.problem

    def versions(self, simulator: Simulator) -> dict[str, str]:
        """Of the simulator's distributions, as installed where it runs; without those that are not."""
        found = self.found(simulator)
        if found is not None:
            return {name: found.versions[name] for name in simulator.distributions if name in found.versions}
        here = {}
        for name in simulator.distributions:
            with contextlib.suppress(metadata.PackageNotFoundError):
                here[name] = metadata.version(name)
        return here

    def for_ray(self, simulator: Simulator) -> dict[str, Any]:
        """The `runtime_env` of a Ray actor that opens the simulator.

        Raises:
            OSError: The folder that shows our source to other environments cannot be written.
        """
        environment = self.of(simulator)
        if environment is None:
            return {"env_vars": worker_environment(simulator)}
        variables = {**worker_environment(simulator), "PYTHONPATH": import_path()}
        return {"env_vars": variables, "py_executable": str(environment.python)}

    def child(self, simulator: Simulator) -> tuple[str, dict[str, str]]:
        """Interpreter and environment variables of a process that opens the simulator.

        Raises:
            OSError: As `for_ray`.
        """
        environment = self.of(simulator)
        variables = {**os.environ, **worker_environment(simulator)}
        if environment is None:
            return sys.executable, variables
        return str(environment.python), {**variables, "PYTHONPATH": import_path()}

    def record(self, simulator: Tenant) -> EnvironmentRecord | None:
        """What a run is to say of the environment; None for the running one, or if it cannot be used."""
        environment, found = self.of(simulator), self.found(simulator)
        if environment is None or found is None or found.problems:
            return None
        return EnvironmentRecord(
            name=environment.name,
            hash=environment.entry.hash,
            python=found.python,
            inherits=environment.entry.inherit and environment.entry.interpreter is None,
            packages={name: version for name, version in found.versions.items() if name != "ray"},
        )
