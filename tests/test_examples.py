"""The examples are run."""

import re
import sys

import pytest

from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.history_import import record_run_folders
from robogauntlet.results.store.run_history import History
from tests import ROOT
from tests.orchestrator.cli.test_compare import bad, good, save
from tests.processes import run_process


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
