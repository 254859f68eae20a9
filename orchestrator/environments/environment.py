"""Which Python environment a simulator or a policy uses, and its folder. Creates nothing."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulator
from robogauntlet.adapters.user_assets import variable
from robogauntlet.policies import catalog as policies
from robogauntlet.policies.contract import PolicyKind
from robogauntlet.suites.environments import Config, EnvironmentEntry
from robogauntlet.suites.episode import content_hash
from robogauntlet.suites.loading import load_config
from robogauntlet.support.errors import BadInput
from robogauntlet.support.json_text import parse_json

MARKER = "environment.json"
"""Written last, so that a folder without it is an unfinished environment."""
RUNNING = f"{sys.version_info.major}.{sys.version_info.minor}"

WORKER_PACKAGES: Mapping[str, str] = {
    "numpy": "numpy",
    "scipy": "scipy",
    "colour-science": "colour",
    "pydantic": "pydantic",
    "pyyaml": "yaml",
    "psutil": "psutil",
    "filelock": "filelock",
    "pillow": "PIL",
    "imageio-ffmpeg": "imageio_ffmpeg",
    "pyarrow": "pyarrow",
}
"""RoboGauntlet's requirements that workers import, besides Ray, each with its module."""


class EnvironmentProblem(BadInput):
    """An environment cannot be created or used; the message says why and what to do."""


EnvironmentUser = Simulator | PolicyKind
"""A simulator or a kind of policy, which can have its own environment."""


@dataclass(frozen=True)
class Environment:
    """A Python environment, which need not exist yet."""

    name: str
    """Name of the simulator or kind of policy that uses it."""
    entry: EnvironmentEntry
    origin: str
    """Where it is declared: `the suite`, `its adapter`, or the path of the configuration file."""

    @property
    def version(self) -> str:
        """Version of its Python, such as `3.12`."""
        return self.entry.python or RUNNING

    @property
    def has_workers(self) -> bool:
        """Whether workers run in it. A policy's own interpreter only computes what its parent asks for."""
        return self.name not in policies.kinds()

    @property
    def folder(self) -> Path:
        """Its folder, which depends on the entry, the Python version, and the environment that it inherits from."""
        identity = [self.entry.hash, self.version, sys.prefix if self.entry.inherit else None]
        return root() / f"{self.name}-{content_hash(identity, length=12)}"

    @property
    def python(self) -> Path:
        """Its interpreter."""
        if self.entry.interpreter is not None:
            return Path(self.entry.interpreter).expanduser()
        return self.folder / "bin" / "python"

    @property
    def site_packages(self) -> list[Path]:
        """The folders of its packages; none if it does not exist."""
        return sorted(self.python.parent.parent.glob("lib/python3*/site-packages"))

    @property
    def manifest(self) -> Mapping[str, Any] | None:
        """The content of its `environment.json`; None if it does not exist, empty for the user's own interpreter."""
        if self.entry.interpreter is not None:
            return {} if os.access(self.python, os.X_OK) else None
        try:
            return dict(parse_json((self.folder / MARKER).read_text(encoding="utf-8")))
        except (OSError, ValueError):
            return None


def environment_users() -> dict[str, EnvironmentUser]:
    """Simulators and kinds of policies with requirements, by name."""
    kinds = {name: kind for name, kind in policies.kinds().items() if kind.requirements or kind.without_dependencies}
    return {**kinds, **catalog.simulators()}


def root() -> Path:
    """The folder of the environments: ROBOGAUNTLET_ENVIRONMENTS, or a folder in the platform's data folder."""
    if named := os.environ.get("ROBOGAUNTLET_ENVIRONMENTS"):
        return Path(named).expanduser().absolute()
    import platformdirs  # not installed in environments that inherit nothing

    return platformdirs.user_data_path("robogauntlet") / "environments"


def config_path() -> Path:
    """The configuration file: ROBOGAUNTLET_CONFIG, or a file in the platform's configuration folder."""
    if named := os.environ.get("ROBOGAUNTLET_CONFIG"):
        return Path(named).expanduser()
    import platformdirs

    return platformdirs.user_config_path("robogauntlet") / "config.yaml"


def read_config() -> Config:
    """Read the user's configuration, which is empty if there is no file.

    Raises:
        SuiteError: The file is invalid, or ROBOGAUNTLET_CONFIG names a missing file.
    """
    path = config_path()
    if not path.exists() and "ROBOGAUNTLET_CONFIG" not in os.environ:
        return Config()
    with_assets = sorted(name for name, simulator in catalog.simulators().items() if simulator.has_assets)
    return load_config(path, sorted(environment_users()), with_assets)


def assets_variables(config: Config) -> dict[str, str]:
    """The variables by which simulators find assets of the user's: as they are set, else by the configuration."""
    users = [name for name, simulator in catalog.simulators().items() if simulator.has_assets]
    named = {variable(name): os.environ.get(variable(name)) or config.assets.get(name) for name in users}
    return {name: folder for name, folder in named.items() if folder}


def declared_environments(user: EnvironmentUser) -> list[Environment]:
    """The environments that a user can have, the preferred one first; none if it runs in the running one."""
    entries = []
    if isinstance(user, PolicyKind):
        new = user.preferred.items()
        entries = [EnvironmentEntry(python=version, requirements=needed, inherit=False) for version, needed in new]
    if user.requirements or user.without_dependencies:
        entries.append(EnvironmentEntry(requirements=user.requirements, without_dependencies=user.without_dependencies))
    return [Environment(user.name, entry, "its adapter") for entry in entries]


def adapter_environment(user: EnvironmentUser, *, always: bool = False) -> Environment | None:
    """The environment that a user declares; unless `always`, only if the running one lacks its modules.

    Of several it is the first that exists, and the last if none does.
    """
    if not (environments := declared_environments(user)):
        return None
    if not always and all(find_spec(module) is not None for module in user.modules):
        return None
    return next((one for one in environments if one.manifest is not None), environments[-1])
