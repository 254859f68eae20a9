"""The Python environments that `make environments` creates, as a user does by `env create`."""

import os
import sys
from pathlib import Path

import pytest

from robogauntlet.orchestrator.environments import environment as environments

FOLDER = os.environ.get("ROBOGAUNTLET_TEST_ENVIRONMENTS", str(Path(sys.prefix) / "environments"))


def python_of(name, *, inheriting=False):
    """The Python of an environment, or this one if it has what is needed; skips where the environment was not made.

    Of several it is the one that runs use, or if `inheriting` the last, which inherits from this one.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROBOGAUNTLET_ENVIRONMENTS", FOLDER)
        environment = environments.adapter_environment(user := environments.environment_users()[name])
        if environment is None:
            return sys.executable
        if inheriting:
            environment = environments.declared_environments(user)[-1]
        if environment.manifest is None:
            pytest.skip(f"not installed: {environment.folder.name}; it is made by `make test`, or by `make nightly`")
        return str(environment.python)
