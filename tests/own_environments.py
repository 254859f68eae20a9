"""The Python environments that `make environments` creates, as a user does by `env create`."""

import os
import sys
from pathlib import Path

import pytest

from robogauntlet.orchestrator.environments.environment import adapter_environment, environment_users

FOLDER = os.environ.get("ROBOGAUNTLET_TEST_ENVIRONMENTS", str(Path(sys.prefix) / "environments"))


def python_of(name, folder=FOLDER):
    """The Python of an environment, or this one if it has what is needed; skips where the environment was not made."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROBOGAUNTLET_ENVIRONMENTS", folder)
        environment = adapter_environment(environment_users()[name])
        if environment is None:
            return sys.executable
        if environment.manifest is None:
            pytest.skip(f"not installed: {environment.folder.name}; type `make environments`")
        return str(environment.python)
