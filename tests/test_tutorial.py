"""The steps of docs/adapters.md lead from an empty folder to an adapter that passes every check."""

import os
import re
import subprocess
import sys
from collections import defaultdict

import pytest

from robogauntlet.orchestrator.adapter_kit.checks import CHECKS
from tests import ROOT

PAGE = (ROOT / "docs" / "adapters.md").read_text(encoding="utf-8")
FILE = re.compile(r'^```\w+ title="(?P<path>[^"]+)"\n(?P<text>.*?)^```$', re.MULTILINE | re.DOTALL)
COMMANDS = re.compile(r"^```console\n(?P<lines>.*?)^```$", re.MULTILINE | re.DOTALL)
GAUNTLET = [sys.executable, "-c", "from robogauntlet.orchestrator.cli import main; main()"]
pytestmark = [pytest.mark.simulator, pytest.mark.ray]


def files():
    """Path to content; blocks of one file follow each other."""
    found = defaultdict(str)
    for block in FILE.finditer(PAGE):
        found[block["path"]] += block["text"]
    return found


def run(command, folder):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(folder)]), "COLUMNS": "200"}
    return subprocess.run(
        command, capture_output=True, text=True, timeout=300, cwd=folder, env=environment, check=False
    )


def test_the_tutorials_adapter_has_at_most_120_lines():
    lines = {path: [line for line in text.splitlines() if line.strip()] for path, text in files().items()}
    assert sum(len(lines[path]) for path in lines if path.startswith("desk/")) <= 120


def test_the_tutorial_leads_to_an_adapter_that_passes_and_can_be_run(tmp_path):
    for path, text in files().items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text(text, encoding="utf-8")
    built = run([sys.executable, "-c", "import setuptools; setuptools.setup()", "-q", "egg_info"], tmp_path)
    assert built.returncode == 0, built.stderr
    (commands,) = COMMANDS.findall(PAGE)
    said = {}
    for line in commands.splitlines():
        done = run([*GAUNTLET, *line.split()[1:]], tmp_path)
        assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
        said[line.split()[1]] = done.stdout
    assert f"{len(CHECKS)} checks on 1 tasks" in said["adapters"]
    assert " 0 failed" in said["adapters"]
    assert re.search(r"desk/Lift\s+100 %", said["run"]), said["run"]
