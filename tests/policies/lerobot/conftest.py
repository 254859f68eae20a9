"""LeRobot's own interpreter, and the declarations of a checkpoint."""

import json
import os

import pytest

from robogauntlet.policies.lerobot.checkpoint import FILES
from tests.own_environments import python_of


@pytest.fixture(scope="session")
def python():
    """The Python of LeRobot's environment, or that of another release, which ROBOGAUNTLET_TEST_LEROBOT names."""
    return os.environ.get("ROBOGAUNTLET_TEST_LEROBOT") or python_of("lerobot")


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
