"""The environment that each simulator and policy runs in, for code that starts processes."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterable, Mapping
from importlib import metadata
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulator
from robogauntlet.orchestrator.environments.check import EnvironmentCheck, check
from robogauntlet.orchestrator.environments.environment import (
    Environment,
    EnvironmentUser,
    adapter_environment,
    assets_variables,
    config_path,
    read_config,
)
from robogauntlet.orchestrator.environments.source_path import import_path
from robogauntlet.policies import catalog as policies
from robogauntlet.policies.contract import PolicyNotInstalled
from robogauntlet.results.run_document import EnvironmentRecord
from robogauntlet.suites.environments import Config, EnvironmentEntry
from robogauntlet.support.secret_variables import POLICY_TOKEN, without_secrets

OBJECT_TOKEN = f"{POLICY_TOKEN}_OBJECT"
"""Variable with the token of the server of this process's objects, see `orchestrator/api`; workers get it, too."""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


def worker_environment(simulator: Simulator, config: Config | None = None) -> dict[str, str]:
    """Environment variables of a process that runs a simulator: one thread, its own variables, and folders of assets.

    The simulator's variables are as the user has set them, if so. The configuration is by default read from its file.
    """
    own = {name: os.environ.get(name, value) for name, value in simulator.environment.items()}
    return {**ONE_THREAD, **own, **assets_variables(config or read_config())}


class EnvironmentResolver:
    """Environments as declared by the suite, else by the user's configuration, else by the adapter."""

    def __init__(self, declared: Mapping[str, EnvironmentEntry] | None = None, config: Config | None = None) -> None:
        """Create a resolver for the environments that a suite declares.

        Args:
            declared: The environments of the suite.
            config: The user's configuration; by default read from its file.

        Raises:
            SuiteError: The user's configuration is invalid.
        """
        self._declared = declared or {}
        self._config = config or read_config()

    def resolve(self, user: EnvironmentUser) -> Environment | None:
        """The environment of a simulator or policy, whether or not it exists; None for the running one."""
        if user.name in self._declared:
            return Environment(user.name, self._declared[user.name], "the suite")
        if (configured := self._config.environments.get(user.name)) is not None:
            return Environment(user.name, configured, str(config_path()))
        return adapter_environment(user)

    def options(self, kind: str, options: Mapping[str, Any]) -> Mapping[str, Any]:
        """A policy's options, with the interpreter of its environment, if it has its own.

        Raises:
            PolicyNotInstalled: The environment does not exist or is unsuitable.
        """
        user = policies.find(kind)
        if not (user.requirements or user.without_dependencies) or "python" in options:
            return options
        if (environment := self.resolve(user)) is None:
            return options
        if problem := check(environment, user).problem:
            raise PolicyNotInstalled(problem)
        return {**options, "python": str(environment.python)}

    def inspect(self, simulator: EnvironmentUser) -> EnvironmentCheck | None:
        """Check the environment of a simulator or policy; None for the running one."""
        environment = self.resolve(simulator)
        return None if environment is None else check(environment, simulator)

    def missing_reason(self, user: EnvironmentUser) -> str | None:
        """Why a simulator or policy cannot be opened, with the remedy; None if no reason is known. Imports nothing."""
        report = self.inspect(user)
        if report is not None:
            return report.problem
        return catalog.missing_reason(user) if isinstance(user, Simulator) else None

    def missing_file(self, user: EnvironmentUser) -> str | None:
        """As `missing_reason`, without starting an environment's interpreter, of which only the file is looked for."""
        environment = self.resolve(user)
        return None if environment is not None and environment.python.exists() else self.missing_reason(user)

    def versions(self, simulator: Simulator) -> dict[str, str]:
        """Versions of the simulator's installed distributions in its environment."""
        report = self.inspect(simulator)
        if report is not None:
            return {name: report.versions[name] for name in simulator.distributions if name in report.versions}
        versions = {}
        for name in simulator.distributions:
            with contextlib.suppress(metadata.PackageNotFoundError):
                versions[name] = metadata.version(name)
        return versions

    def ray_runtime_env(self, simulator: Simulator) -> dict[str, Any]:
        """The `runtime_env` of a Ray actor that opens the simulator.

        Raises:
            OSError: The folder with links to the source cannot be written.
        """
        variables = worker_environment(simulator, self._config)
        if token := os.environ.get(OBJECT_TOKEN):
            variables[OBJECT_TOKEN] = token  # Ray may have been started before it was set.
        if (environment := self.resolve(simulator)) is None:
            return {"env_vars": variables}
        variables["PYTHONPATH"] = import_path()
        return {"env_vars": variables, "py_executable": str(environment.python)}

    def shared_variables(self, simulators: Iterable[str]) -> dict[str, str]:
        """The environment variables that all processes have that open one of the simulators."""
        variables = [set(worker_environment(catalog.find(name), self._config).items()) for name in simulators]
        return dict(set.intersection(*variables)) if variables else {}

    def subprocess_env(self, simulator: Simulator) -> tuple[str, dict[str, str]]:
        """Interpreter and environment variables of a process that opens the simulator.

        Raises:
            OSError: As `ray_runtime_env`.
        """
        environment = self.resolve(simulator)
        variables = {**without_secrets(os.environ), **worker_environment(simulator, self._config)}
        if environment is None:
            return sys.executable, variables
        return str(environment.python), {**variables, "PYTHONPATH": import_path()}

    def record(self, simulator: EnvironmentUser) -> EnvironmentRecord | None:
        """The environment's record for a run; None for the running one, or if it cannot be used."""
        environment, report = self.resolve(simulator), self.inspect(simulator)
        if environment is None or report is None or report.problems:
            return None
        return EnvironmentRecord(
            name=environment.name,
            hash=environment.entry.hash,
            python=report.python,
            inherits=environment.entry.inherit and environment.entry.interpreter is None,
            packages={name: version for name, version in report.versions.items() if name != "ray"},
        )
