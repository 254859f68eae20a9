"""The examples are run."""

import re
import runpy
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from robogauntlet.orchestrator.runs.checkpoint_folder import ReadyCheckpoints
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


def test_a_policys_history_is_printed(two_nights):
    history = History.open(file_url(two_nights / "runs" / "history.sqlite"))
    record_run_folders(history, two_nights / "runs")
    history.close()
    output = example("follow_a_policy.py", "runs/history.sqlite", "p", cwd=two_nights)
    assert [line.split()[2] for line in output.splitlines()[1:3]] == ["monday", "tuesday"]


@pytest.mark.nightly  # importing torch takes seconds
def test_a_training_writes_checkpoints_that_are_watched_as_they_are(tmp_path, monkeypatch):
    environment = SimpleNamespace(
        reset=lambda seed: ({"images": {"third_person": np.full((96, 96, 3), seed % 256, np.uint8)}}, {}),
        simulation=SimpleNamespace(privileged_state=lambda: {"goal_position": np.array([0.5, 0.0, 0.2])}),
        close=lambda: None,
    )
    monkeypatch.setattr("robogauntlet.make", lambda task: environment)
    training = runpy.run_path(str(ROOT / "examples" / "watch_a_training.py"))
    training["train"](tmp_path, steps=2, every=1, scenes=2)
    whole = ReadyCheckpoints(tmp_path, 0.0, pytest.fail).look()
    assert [one.name for one in whole] == ["checkpoint-2", "checkpoint-1"]
    chunk = training["Policy"](str(whole[0].folder))(environment.reset(0)[0]["images"], np.zeros(8), "reach")
    assert chunk.shape == (8, 7)


def test_the_pages_have_the_function_of_the_example():
    sources = [ROOT / "examples" / "evaluate_a_function.py", ROOT / "README.md", ROOT / "docs" / "python.md"]
    texts = [path.read_text(encoding="utf-8") for path in sources]
    functions = [
        re.search(r"^    .{3}Move the tool.*?^    return [^\n]*\n", text, re.MULTILINE | re.DOTALL)[0] for text in texts
    ]
    assert len(functions[0].splitlines()) > 10
    assert set(functions) == {functions[0]}


@pytest.mark.simulator
@pytest.mark.ray
@pytest.mark.nightly
def test_a_function_is_evaluated_and_stepped(tmp_path):
    output = example("evaluate_a_function.py", cwd=tmp_path)
    assert re.search(r"act pybullet/PandaReach-v3\s+clean\s+(0.75|1.00)", output)
    assert re.search(r"act pybullet/PandaReach-v3\s+noise@2\s+[01].\d\d", output)
    assert output.count("failure") + output.count("success ") >= 8
    assert "reach" in output
    assert "(256, 256, 3)" in output
