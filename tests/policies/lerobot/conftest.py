"""LeRobot's own interpreter, and the declarations of a checkpoint."""

import json
import os
import sys
from pathlib import Path

import pytest

from robogauntlet.orchestrator.environments.environment import Environment, adapter_environment
from robogauntlet.policies import catalog
from robogauntlet.policies.lerobot.checkpoint import FILES


@pytest.fixture(scope="session")
def environments():
    """The folder of `make test`'s environments."""
    return os.environ.get("ROBOGAUNTLET_TEST_ENVIRONMENTS", str(Path(sys.prefix) / "environments"))


@pytest.fixture(scope="session")
def python(environments):
    """The Python of `robogauntlet env create lerobot`, which `make test` creates next to the running environment.

    Or that of another release, which ROBOGAUNTLET_TEST_LEROBOT names.
    """
    if named := os.environ.get("ROBOGAUNTLET_TEST_LEROBOT"):
        return named
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROBOGAUNTLET_ENVIRONMENTS", environments)
        environment: Environment | None = adapter_environment(catalog.find("lerobot"))
        if environment is None:
            return sys.executable
        if environment.manifest is None:
            pytest.skip(f"not there: ROBOGAUNTLET_ENVIRONMENTS={environments} robogauntlet env create lerobot")
        return str(environment.python)


@pytest.fixture
def bare(tmp_path):
    """The declarations of a checkpoint, without weights: all that is read before it is loaded."""

    def write(**changed):
        features = {"observation.images.front": {"shape": [3, 32, 32]}, "observation.state": {"shape": [8]}}
        config = {"type": "act", "n_action_steps": 3, "input_features": features}
        config["output_features"] = {"action": {"shape": [7]}}
        for name in FILES:
            (tmp_path / name).write_text(json.dumps({**config, **changed}) if name == FILES[0] else "{}")
        return tmp_path

    return write
