"""The examples do what they say: their steps are run as they stand."""

import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
SUITE = """
name: nightly
policies: [oracle, random]
tasks: [null/Reach]
seeds: {count: 40}
"""
pytestmark = pytest.mark.ray


@pytest.fixture
def night(tmp_path):
    """Runs a step of the workflow as GitHub would, in a folder with a suite; returns exit code and summary."""
    workflow = yaml.safe_load((ROOT / "examples/github-nightly.yml").read_text())
    steps = {step["name"]: step["run"] for step in workflow["jobs"]["gauntlet"]["steps"] if "run" in step}
    (tmp_path / "suite.yaml").write_text(SUITE)
    program = tmp_path / "bin" / "gauntlet"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -c "from orchestrator.cli import main; main()" "$@"\n')
    program.chmod(0o755)

    def run(name):
        summary = tmp_path / "summary.md"
        summary.write_text("")
        environment = {
            **os.environ,
            "SUITE": "suite.yaml",
            "GITHUB_STEP_SUMMARY": str(summary),
            "PATH": f"{program.parent}:{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
        }
        done = subprocess.run(["bash", "-e", "-c", steps[name]], cwd=tmp_path, env=environment, check=False)
        return done.returncode, summary.read_text()

    return run


def test_the_workflow_passes_on_good_nights_and_fails_on_a_regression(night, tmp_path):
    assert night("play") == (0, "")
    assert night("judge") == (0, "the first night: nothing to hold it against\n")
    assert night("keep a good night") == (0, "")
    assert night("play")[0] == 0
    code, summary = night("judge")
    assert code == 0
    assert "### ✅ no evidence of a difference" in summary
    with sqlite3.connect(tmp_path / "runs" / "now" / "episodes.sqlite") as database:
        database.execute("update episodes set status = 'failure' where policy = 'oracle' and seed < 12")
    code, summary = night("judge")
    assert code == 1
    assert "oracle, null/Reach: 100 % before, 70 % now of 40 episodes, -30.0 points" in summary
