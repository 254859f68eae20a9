"""LeRobot's own interpreter, and the declarations of a checkpoint."""

import json

import pytest

from robogauntlet.policies.lerobot.checkpoint import FILES
from tests.own_environments import python_of
from tests.processes import run_process


@pytest.fixture(scope="session")
def python():
    """The Python of LeRobot's environment, as `env create` makes it on this machine."""
    return python_of("lerobot")


@pytest.fixture(scope="session")
def newer(python):
    """The Python of LeRobot 0.6.1."""
    if run_process([python, "-c", "import sys; sys.exit(sys.version_info < (3, 12))"]).returncode:
        pytest.skip("this machine has no Python 3.12 or 3.13, so LeRobot 0.4.4 is played")
    return python


@pytest.fixture(scope="session", params=["0.4.4", pytest.param("as made here", marks=pytest.mark.nightly)])
def each_python(request):
    """That of LeRobot 0.4.4, as `env create` makes it where there is no newer Python, and as it makes it here."""
    return python_of("lerobot", inheriting=request.param == "0.4.4")


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
