"""A LeRobot checkpoint plays LIBERO through the normal command, each in an interpreter of its own."""

import subprocess

import pytest

from robogauntlet.adapters.libero.assets import VARIABLE, unpack
from robogauntlet.results.api import open_run
from tests import ROOT
from tests.policies.lerobot.test_lerobot import CHUNK, MAKING
from tests.processes import GAUNTLET, environment_of

TASK = "libero/spatial-0-between-plate-ramekin"


@pytest.mark.slow
@pytest.mark.simulator
@pytest.mark.ray
def test_an_act_policy_in_liberos_convention_plays_a_suite_of_libero(python, environments, tmp_path):
    checkpoint, folder = tmp_path / "act", tmp_path / "run"
    assets = unpack(ROOT / "tests/data/libero-assets.tar.xz", tmp_path / "assets")
    configuration = tmp_path / "config.yaml"
    configuration.write_text(f"environments: {{lerobot: {{interpreter: {python}}}}}")
    places = {"ROBOGAUNTLET_ENVIRONMENTS": environments, VARIABLE: str(assets.folder)}
    places["ROBOGAUNTLET_CONFIG"] = str(configuration)
    played = ("--policy", f"lerobot:{checkpoint}", "--option", "convention=libero")
    for command in (
        [python, MAKING, checkpoint, "--only-act", "224"],
        [*GAUNTLET, "env", "create", "libero"],
        [*GAUNTLET, "run", "libero-spatial", *played, "--task", TASK, "--seeds", "1", "--out", folder, "--no-media"],
    ):
        done = subprocess.run(command, env=environment_of(ROOT, **places), capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    (row,) = open_run(folder).episodes().itertuples()
    assert (row.task, row.status, row.steps, row.queries) == (TASK, "failure", 220, -(-220 // CHUNK["act"]))
