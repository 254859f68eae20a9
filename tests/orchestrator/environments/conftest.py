"""Simulators that need different versions of a distribution, its wheels, and environments made from them."""

import os

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments import installer
from robogauntlet.orchestrator.environments.environment import Environment
from robogauntlet.suites.environments import EnvironmentEntry
from tests.orchestrator.environments.wheels import write_adapter, write_wheel


@pytest.fixture(scope="module")
def simulators(tmp_path_factory):
    """Declares the simulators `first`, `second` and `bare`; pip finds the wheels, and nothing else."""
    folder = tmp_path_factory.mktemp("simulators")
    write_adapter(folder)
    for version in ("1.0", "2.0"):
        write_wheel(folder, version)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))
        for name, value in {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(folder)}.items():
            patch.setenv(name, value)
        patch.setenv("ROBOGAUNTLET_ENVIRONMENTS", str(folder / "environments"))
        catalog._load.cache_clear()
        yield folder
    catalog._load.cache_clear()


@pytest.fixture
def environment(simulators, tmp_path, monkeypatch):
    """An environment for `bare`, in a folder of the test's own."""
    monkeypatch.setenv("ROBOGAUNTLET_ENVIRONMENTS", str(tmp_path / "environments"))

    def declare(**entry):
        return Environment("bare", EnvironmentEntry(**entry), "the suite")

    return declare


@pytest.fixture(scope="module")
def made(simulators):
    """The environments of `first` and `second`, made as their adapters say."""
    for name, version in (("first", "1.0"), ("second", "2.0")):
        entry = EnvironmentEntry(requirements=(f"gearbox=={version}",))
        installer.create(Environment(name, entry, "its adapter"), lambda line: None)
