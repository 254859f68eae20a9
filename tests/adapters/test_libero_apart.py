"""LIBERO in the environment of `robogauntlet env create`, on a machine that has only the archive of assets."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robogauntlet.adapters.libero.assets import package_folder
from robogauntlet.adapters.user_assets import variable
from robogauntlet.results.api import open_run
from tests import ROOT
from tests.jobs import mostly_nightly
from tests.own_environments import FOLDER, python_of
from tests.remote_servers import answering, speaking

PACK = ROOT / "tests" / "data" / "libero-assets.tar.xz"
SUITE = """
name: both
policies: [oracle]
tasks: [robosuite/Lift, libero/goal-7-*]
seeds: {start: 0, count: 1}
workers: {robosuite: 1, libero: 1}
"""
pytestmark = [
    pytest.mark.simulator,
    pytest.mark.slow,
    pytest.mark.ray,
    pytest.mark.skipif(
        package_folder() is not None, reason="this machine has LIBERO beside the tests, which run as they are"
    ),
]


@pytest.fixture(scope="module")
def surroundings(request):
    """Environment variables under which LIBERO is found: its Python environment, and few assets for speed."""
    kept = Path(request.config.cache.mkdir("libero"))
    if not (kept / "assets").is_dir():
        shutil.unpack_archive(PACK, kept / "partial", filter="data")
        (kept / "partial" / "assets").rename(kept / "assets")
    named = {"ROBOGAUNTLET_ENVIRONMENTS": FOLDER, variable("libero"): str(kept / "assets")}
    return os.environ | named


def run_command(surroundings, *arguments):
    command = [sys.executable, "-c", "from robogauntlet.orchestrator.cli import main; main()", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=surroundings, timeout=600)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="module")
def python():
    return python_of("libero")


def test_robosuite_1_4_shadows_the_one_behind_it(surroundings, python):
    code = (
        "import json, robosuite, mujoco, ray\n"
        "print(json.dumps([robosuite.__version__, robosuite.__file__, mujoco.__version__, ray.__file__]))"
    )
    done = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True, env=surroundings)
    version, place, mujoco, ray = json.loads(done.stdout.splitlines()[-1])
    assert version == "1.4.0"
    assert place.startswith(str(Path(python).parents[1]))
    assert mujoco == "3.3.7"
    assert not ray.startswith(str(Path(python).parents[1]))


@pytest.mark.parametrize(
    "name",
    mostly_nightly(
        [
            "adapters/test_libero.py",
            "adapters/test_libero.py --job nightly",
            "adapters/test_libero_control.py",
            "policies/test_libero_oracles.py",
        ],
        ["adapters/test_libero.py"],
    ),
)
def test_the_tests_of_liberos_adapter_and_oracles_pass_there(surroundings, python, name):
    command = [python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *f"tests/{name}".split()]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=surroundings)
    assert done.returncode == 0, done.stdout[-6000:]
    skipped = [line for line in done.stdout.splitlines() if line.startswith("SKIPPED")]
    assert all("OpenBLAS round differently" in line for line in skipped)
    assert bool(skipped) == ("skipped" in done.stdout.splitlines()[-1])


@pytest.mark.nightly
def test_a_server_in_openpis_protocol_plays_a_suite_of_libero_under_the_protocol_of_published_results(
    surroundings, python, tmp_path
):
    seen, forward = [], {"actions": np.tile([0.3, 0.0, -0.3, 0.0, 0.0, 0.0, -1.0], (10, 1))}
    task, folder = "libero/spatial-0-between-plate-ramekin", tmp_path / "run"
    with speaking(answering(forward, seen=seen)) as address:
        options = [f"--option={option}" for option in ("convention=libero", "image_size=224", "execute=5")]
        arguments = ["--policy", f"openpi:{address}", *options, "--task", task, "--seeds", "1"]
        run_command(surroundings, "run", "libero-openvla", *arguments, "--out", str(folder), "--no-media")
    (row,) = open_run(folder).episodes().itertuples()
    assert (row.task, row.status, row.protocol, row.steps) == (task, "failure", "openvla", 220)
    assert len(seen) == row.queries == 220 / 5
    assert seen[0]["observation/image"].shape == seen[0]["observation/wrist_image"].shape == (224, 224, 3)
    assert "under the protocol openvla" in (folder / "report.md").read_text()


def test_robosuite_1_5_and_libero_are_played_in_one_run(surroundings, python, tmp_path):
    suite, folder = tmp_path / "both.yaml", tmp_path / "run"
    suite.write_text(SUITE)
    run_command(surroundings, "run", str(suite), "--out", str(folder), "--no-media")
    run = open_run(folder)
    document = run.document
    assert document.provenance.packages["robosuite"] == "1.5.2"
    assert document.provenance.environments["libero"].packages["robosuite"] == "1.4.0"
    assert "with stand-ins" in document.render_devices["libero"]
    rows = run.episodes(("task", "status"))
    assert sorted(rows["task"]) == ["libero/goal-7-turn-on-stove", "robosuite/Lift"]
    assert set(rows["status"]) == {"success"}
