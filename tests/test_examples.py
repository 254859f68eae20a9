"""The steps of the examples are run."""

import os
import re
import sqlite3
import subprocess
import sys

import pytest
import yaml

from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.history_import import record_run_folders
from robogauntlet.results.store.run_history import History
from tests import ROOT
from tests.orchestrator.cli.test_compare import bad, good, save
from tests.processes import run_process

PYTHONPATH = f"{ROOT / 'src'}{os.pathsep}{ROOT}"
SUITE = """
name: nightly
policies: [oracle, random]
tasks: [null/Reach]
seeds: {count: 40}
"""


@pytest.fixture
def night(tmp_path):
    """Runs a step of the workflow as GitHub would, in a folder with a suite; returns exit code and summary."""
    workflow = yaml.safe_load((ROOT / "examples/github-nightly.yml").read_text())
    steps = {step["name"]: step["run"] for step in workflow["jobs"]["robogauntlet"]["steps"] if "run" in step}
    (tmp_path / "suite.yaml").write_text(SUITE)
    program = tmp_path / "bin" / "robogauntlet"
    program.parent.mkdir()
    program.write_text(
        f'#!/bin/sh\nexec {sys.executable} -c "from robogauntlet.orchestrator.cli import main; main()" "$@"\n'
    )
    program.chmod(0o755)

    def run(name):
        summary = tmp_path / "summary.md"
        summary.write_text("")
        environment = {
            **os.environ,
            "SUITE": "suite.yaml",
            "GITHUB_STEP_SUMMARY": str(summary),
            "PATH": f"{program.parent}:{os.environ['PATH']}",
            "PYTHONPATH": PYTHONPATH,
        }
        step = subprocess.run(["bash", "-e", "-c", steps[name]], cwd=tmp_path, env=environment, check=False)
        return step.returncode, summary.read_text()

    return run


@pytest.mark.ray
def test_the_workflow_passes_on_good_runs_and_fails_on_a_regression(night, tmp_path):
    assert night("play") == (0, "")
    assert night("compare") == (0, "the first night: no baseline to compare with yet\n")
    assert night("keep a good night") == (0, "")
    assert night("play")[0] == 0
    code, summary = night("compare")
    assert code == 0
    assert "### ✅ no evidence of a difference" in summary
    with sqlite3.connect(tmp_path / "runs" / "now" / "episodes.sqlite") as database:
        database.execute("update episodes set status = 'failure' where policy = 'oracle' and seed < 12")
    code, summary = night("compare")
    assert code == 1
    assert "oracle, null/Reach: 100 % before, 70 % now of 40 episodes, -30.0 points" in summary


def example(name, *arguments, cwd):
    run = run_process([sys.executable, ROOT / "examples" / name, *arguments], cwd)
    assert run.returncode == 0, run.stderr
    return run.stdout


@pytest.fixture
def two_nights(tmp_path):
    save(tmp_path / "runs" / "monday", good, run_id="1", started_at=1.0)
    save(tmp_path / "runs" / "tuesday", bad, run_id="2", started_at=86_400.0)
    return tmp_path


def test_a_run_is_a_table(two_nights):
    output = example("open_a_run.py", "runs/monday", cwd=two_nights)
    assert "runs/monday: suite synthetic, 160 episodes planned, complete" in output
    assert "p on maniskill/A: 0.75 [0.60, 0.86]" in output


def test_two_runs_are_compared_and_lost_episodes_listed(two_nights):
    output = example("compare_two_runs.py", "runs/tuesday", "runs/monday", cwd=two_nights)
    assert "REGRESSED: tuesday against monday" in output
    assert "20 episodes succeeded before and fail now" in output
    assert output.count("robogauntlet replay ") == 5


def test_a_policys_history_is_printed_and_plotted(two_nights):
    history = History.open(file_url(two_nights / "runs" / "history.sqlite"))
    record_run_folders(history, two_nights / "runs")
    history.close()
    output = example("follow_a_policy.py", "runs/history.sqlite", "p", "plot.svg", cwd=two_nights)
    assert [line.split()[2] for line in output.splitlines()[1:3]] == ["monday", "tuesday"]
    assert (two_nights / "plot.svg").read_text().startswith("<svg")


@pytest.mark.simulator
@pytest.mark.ray
def test_a_function_is_evaluated_and_stepped(tmp_path):
    output = example("evaluate_a_function.py", cwd=tmp_path)
    assert re.search(r"towards_the_middle pybullet/PandaReach-v3\s+noise@2\s+[01].\d\d", output)
    assert output.count("failure") + output.count("success ") >= 8
    assert "reach" in output
    assert "(256, 256, 3)" in output
