"""A LeRobot checkpoint plays LIBERO through the normal command, each in an interpreter of its own."""

import subprocess

import pytest

from robogauntlet.results.api import open_run
from tests import ROOT
from tests.own_environments import FOLDER, python_of
from tests.policies.lerobot.asking import CHUNK, MAKING
from tests.processes import GAUNTLET, environment_of

TASK = "libero/spatial-0-between-plate-ramekin"


@pytest.mark.nightly
@pytest.mark.simulator
@pytest.mark.ray
def test_an_act_policy_in_liberos_convention_plays_a_suite_of_libero_with_its_real_assets(python, tmp_path):
    python_of("libero")
    checkpoint, folder = tmp_path / "act", tmp_path / "run"
    configuration = tmp_path / "config.yaml"
    configuration.write_text(f"environments: {{lerobot: {{interpreter: {python}}}}}")
    places = {"ROBOGAUNTLET_ENVIRONMENTS": FOLDER, "ROBOGAUNTLET_CONFIG": str(configuration)}
    played = ("--policy", f"lerobot:{checkpoint}", "--option", "convention=libero")
    for command in (
        [python, MAKING, checkpoint, "--only-act", "224"],
        [*GAUNTLET, "run", "libero-spatial", *played, "--task", TASK, "--seeds", "1", "--out", folder, "--no-media"],
    ):
        done = subprocess.run(command, env=environment_of(ROOT, **places), capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    run = open_run(folder)
    assert run.document.render_devices["libero"].endswith("without stand-ins")
    (row,) = run.episodes().itertuples()
    assert (row.task, row.status, row.steps, row.queries) == (TASK, "failure", 220, -(-220 // CHUNK["act"]))
