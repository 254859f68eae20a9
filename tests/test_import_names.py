"""RoboGauntlet uses one import name: packages of users may have the names of its folders."""

import sys

import pytest

from tests import ROOT
from tests.processes import run_gauntlet, run_process

FOLDERS = ("suites", "adapters", "policies", "results", "orchestrator")
ACT = """
import numpy as np

def act(images, proprioception, instruction):
    return np.zeros((1, 7))
"""
SUITE = """
name: mine
policies: ["python:policies.mine:act"]
tasks: [null/Reach]
seeds: {count: 2}
"""
SCRIPT = """
import robogauntlet.policies.catalog
import adapters, policies, results
print([module.MINE for module in (adapters, policies, results)])
"""


def python(*arguments, folder):
    return run_process([sys.executable, *arguments], folder)


@pytest.fixture
def project(tmp_path):
    """A user's folder, with packages named as ours are."""
    for name in FOLDERS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("MINE = True\n")
    (tmp_path / "policies" / "mine.py").write_text(ACT)
    (tmp_path / "mine.yaml").write_text(SUITE)
    return tmp_path


def test_a_script_beside_packages_of_these_names_imports_them(project):
    (project / "script.py").write_text(SCRIPT)
    done = python("script.py", folder=project)
    assert done.stdout.strip() == "[True, True, True]", done.stderr


@pytest.mark.ray
def test_a_run_uses_a_policy_from_the_users_own_package_policies(project):
    done = run_gauntlet("run", "mine.yaml", "--out", "run", cwd=project)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (project / "run" / "report.html").is_file()


def test_the_pytest_plugin_works_beside_another_package_orchestrator(project):
    (project / "test_own.py").write_text("import orchestrator\n\ndef test_own():\n    assert orchestrator.MINE\n")
    done = python("-m", "pytest", "-q", "-p", "no:cacheprovider", folder=project)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout


def test_the_pytest_plugin_imports_nothing_heavy():
    code = "import sys, pytest, robogauntlet.orchestrator.kit.pytest_plugin; print(*sys.modules)"
    loaded = python("-c", code, folder=ROOT).stdout.split()
    assert "robogauntlet.orchestrator.kit.pytest_plugin" in loaded
    assert not {"numpy", "scipy", "pydantic", "ray", "yaml"} & set(loaded)
    assert {name for name in loaded if name.startswith("robogauntlet.")} == {
        "robogauntlet.orchestrator",
        "robogauntlet.orchestrator.kit",
        "robogauntlet.orchestrator.kit.pytest_plugin",
    }


def test_adapters_are_checked_without_pytest():
    code = "import sys, robogauntlet.orchestrator.cli.check.adapter; print('pytest' in sys.modules)"
    assert python("-c", code, folder=ROOT).stdout.strip() == "False"


@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_imported_by_its_bare_name_is_refused_in_a_line(name):
    done = python("-c", f"import {name}", folder=ROOT)
    assert done.returncode == 1
    expected = f"ImportError: '{name}' is RoboGauntlet's own folder; import robogauntlet.{name}"
    assert done.stderr.splitlines()[-1] == expected
