"""LIBERO-Plus in the environment of `robogauntlet env create`."""

import subprocess
from pathlib import Path

import pytest

from robogauntlet.adapters.libero.assets import package_folder
from tests import ROOT
from tests.adapters.test_libero_apart import run_command, surroundings

pytestmark = [
    pytest.mark.simulator,
    pytest.mark.slow,
    pytest.mark.skipif(package_folder() is not None, reason="LIBERO is installed here: its tests run as they are"),
]
__all__ = ["surroundings"]


def test_the_tests_of_liberopluss_adapter_pass_there(surroundings):
    run_command(surroundings, "env", "create", "libero-plus")
    (python,) = Path(surroundings["ROBOGAUNTLET_ENVIRONMENTS"]).glob("libero-plus-*/bin/python")
    command = [str(python), "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    done = subprocess.run(
        [*command, "tests/adapters/test_libero_plus.py"],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env=surroundings,
    )
    assert done.returncode == 0, done.stdout[-6000:]
    assert "skipped" not in done.stdout.splitlines()[-1]
