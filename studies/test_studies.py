"""What the README of each study shows is printed by its command from the rows that are kept."""

import json
import os
import subprocess
import sys

import pytest

from studies.hundredth import SCRIPTS
from studies.percent import LACKING
from studies.tables import BLOCK, NAMES, ROOT, STUDIES, readme, with_tables
from tests.test_scripts import commands_of, parsed


@pytest.mark.parametrize("study", NAMES)
def test_the_tables_of_a_readme_are_those_of_the_kept_rows(study):
    text = readme(study).read_text(encoding="utf-8")
    assert with_tables(study, text) == text
    assert {name for _, name in BLOCK.findall(text)} == {path.stem for path in STUDIES.glob(f"{study}/rows/*.json")}


@pytest.mark.parametrize(
    ("script", "verbs"),
    [
        ("merging/training_controls.sh", 325),
        ("robust_experts/robust_experts.sh", 31),
        ("arms/arms.sh", 24),
        ("two_arms/two_arms.sh", 10),
        ("so101/so101.sh", 5),
        ("more_experts/meta_world.sh", 40),
        ("libero/libero.sh", 55),
    ],
)
def test_every_command_of_a_script_is_valid(script, verbs, tmp_path):
    commands = commands_of(STUDIES / script, tmp_path)
    for command in commands:
        parsed(command)
    assert len(commands) == verbs


def test_a_suite_that_libero_lacks_is_refused_first(tmp_path):
    with pytest.raises(subprocess.CalledProcessError) as refused:
        commands_of(STUDIES / "libero/libero.sh", tmp_path, "goal", "gaol")
    assert refused.value.stderr == "SUITE: expected spatial, object, goal or 10, got 'gaol'\n"
    assert not (tmp_path / "commands").exists()


def test_a_hundredth_of_every_training_script_is_run_each_night():
    assert SCRIPTS.keys() == {str(path.relative_to(STUDIES)) for path in STUDIES.glob("*/*.sh")}


def ended(*words, **variables):
    command = [sys.executable, "-m", "studies", *words]
    return subprocess.run(command, cwd=ROOT, env={**os.environ, **variables}, capture_output=True, text=True)


def test_a_hundredth_is_measured_beside_the_whole_and_cannot_be_kept():
    measured = ROOT / "runs/bench-1-percent/worst_cases.json"
    measured.unlink(missing_ok=True)
    assert ended("worst_cases", "--measure", "worst_cases", PERCENT="1").returncode == 0
    assert json.loads(measured.read_text())["percent"] == 1
    kept = ended("worst_cases", "--keep", "worst_cases", PERCENT="1")
    message = "--keep worst_cases: expected a whole measurement, got PERCENT=1: measure without it\n"
    assert (kept.returncode, kept.stderr) == (2, message)


def test_a_table_that_a_study_lacks_is_one_line():
    refused = ended("routing", "--measure", "nope")
    assert refused.returncode == 2
    assert refused.stderr.splitlines()[-1].endswith(
        "expected a table of routing (routers, unknown_tasks, false_alarms, shifted_routing), got 'nope'"
    )


def test_a_share_that_is_no_whole_percent_is_refused():
    refused = ended("oracles", PERCENT="0.5")
    message = "PERCENT: expected a whole number from 1 to 999, got '0.5'\n"
    assert (refused.returncode, refused.stderr) == (2, message)


def test_a_measurement_says_what_the_machine_lacks():
    refused = ended("performance", "--measure", "gpu_answers", CUDA_VISIBLE_DEVICES="")
    assert (refused.returncode, refused.stderr) == (LACKING, "gpu_answers: expected a GPU\n")
