"""LIBERO-Plus in the environment of `robogauntlet env create`."""

import subprocess

import pytest

from robogauntlet.adapters.libero.assets import package_folder
from robogauntlet.adapters.user_assets import variable
from robogauntlet.results.api import open_run
from tests import ROOT
from tests.adapters.test_libero_apart import run_command, surroundings
from tests.own_environments import python_of

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.simulator,
    pytest.mark.slow,
    pytest.mark.skipif(
        package_folder() is not None, reason="this machine has LIBERO beside the tests, which run as they are"
    ),
]
TASK = "libero-plus/camera-goal-7-0-0-171-0-0"
__all__ = ["surroundings"]


def test_the_tests_of_liberopluss_adapter_pass_there(surroundings):
    command = [python_of("libero-plus"), "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    command.append("tests/adapters/test_libero_plus.py")
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=surroundings)
    assert done.returncode == 0, done.stdout[-6000:]
    assert "skipped" not in done.stdout.splitlines()[-1]


@pytest.mark.ray
def test_a_variant_is_played_with_the_real_assets(surroundings, tmp_path):
    python_of("libero-plus")
    suite, folder = tmp_path / "camera.yaml", tmp_path / "run"
    suite.write_text(f"name: camera\npolicies: [zero]\ntasks: [{TASK}]\nseeds: {{count: 1}}\nhorizon: 16\n")
    with_assets = {name: value for name, value in surroundings.items() if name != variable("libero")}
    run_command(with_assets, "run", str(suite), "--out", str(folder), "--no-media")
    run = open_run(folder)
    assert run.document.render_devices["libero-plus"].endswith("without stand-ins")
    (row,) = run.episodes().itertuples()
    assert (row.task, row.status, row.steps) == (TASK, "failure", 16)
