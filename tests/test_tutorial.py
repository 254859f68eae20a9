"""The steps of docs/adapters.md lead from an empty folder to an adapter that passes every check."""

import re
import sys
from collections import defaultdict

import pytest

from robogauntlet.orchestrator.kit.adapter import CHECKS
from tests.processes import run_gauntlet, run_process
from tests.tutorials import blocks

pytestmark = [pytest.mark.simulator, pytest.mark.ray]


def files():
    """Path to content; blocks of one file follow each other."""
    found = defaultdict(str)
    for path, text in blocks("adapters"):
        if path is not None:
            found[path] += text
    return found


def test_the_tutorials_adapter_has_at_most_120_lines():
    lines = {path: [line for line in text.splitlines() if line.strip()] for path, text in files().items()}
    assert sum(len(lines[path]) for path in lines if path.startswith("desk/")) <= 120


def test_the_tutorial_leads_to_an_adapter_that_passes_and_can_be_run(tmp_path):
    for path, text in files().items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(text, encoding="utf-8")
    built = run_process([sys.executable, "-c", "import setuptools; setuptools.setup()", "-q", "egg_info"], tmp_path)
    assert built.returncode == 0, built.stderr
    (commands,) = (text for path, text in blocks("adapters") if path is None)
    printed = {}
    for line in commands.splitlines():
        done = run_gauntlet(*line.split()[1:], cwd=tmp_path, paths=[tmp_path])
        assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
        printed[line.split()[1]] = done.stdout
    of_tools = [check for check in CHECKS.values() if not check.of_joints]
    assert f"{len(of_tools)} checks on 1 task in" in printed["check"]
    assert " 0 failed" in printed["check"]
    assert re.search(r"desk/Lift\s+100 %", printed["run"]), printed["run"]
