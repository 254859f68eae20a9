"""The section about LeRobot leads from a checkpoint to a table."""

import os
import shutil
import subprocess

import pytest

from tests import ROOT
from tests.own_environments import FOLDER
from tests.policies.lerobot.asking import MAKING
from tests.processes import environment_of
from tests.tutorials import follow

FEATURES = {"observation.images.third_person": {"shape": [3, 96, 96]}, "observation.state": {"shape": [8]}}


def test_the_suite_of_the_section_is_valid_where_lerobot_is_not_installed(bare, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    shutil.copytree(bare(input_features=FEATURES), folder / "checkpoints" / "act_push")
    later = ("robogauntlet env", "robogauntlet check", "robogauntlet run")
    (printed,) = follow(
        "your-policy", "LeRobot checkpoints", folder, skipped=later, ROBOGAUNTLET_ENVIRONMENTS=os.devnull
    ).values()
    assert "act.yaml: valid, 5 episodes" in printed
    assert "create it: robogauntlet env create lerobot" in printed


@pytest.mark.slow
@pytest.mark.simulator
@pytest.mark.ray
@pytest.mark.nightly
def test_the_section_leads_from_a_checkpoint_to_a_table(python, tmp_path):
    command = [python, MAKING, tmp_path / "checkpoints" / "act_push", "--only-act", "96"]
    subprocess.run(command, env=environment_of(ROOT), check=True, capture_output=True)
    made = {"skipped": ("robogauntlet env",), "ROBOGAUNTLET_ENVIRONMENTS": FOLDER}
    valid, checked, played = follow("your-policy", "LeRobot checkpoints", tmp_path, **made).values()
    assert "valid" in valid
    assert " 0 failed, " in checked
    assert "5 of 5 episodes" in played
