"""`robogauntlet new adapter` and `check adapter`, and the list of simulators."""

import json
import re
import sys
from importlib import metadata

import pytest
from typer.testing import CliRunner

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.cli import app
from robogauntlet.orchestrator.cli.check.adapter import check
from robogauntlet.orchestrator.cli.common import INPUT_ERRORS
from robogauntlet.orchestrator.cli.new.adapter import new
from robogauntlet.orchestrator.kit.scaffold import ADAPTER
from robogauntlet.suites.loading import load_suite
from robogauntlet.suites.registry import KnownPolicy, KnownTask, Registry
from tests import ROOT
from tests.full_disk import full_disk
from tests.processes import run_gauntlet, run_process

KNOWN = Registry(
    {"my-sim/Reach": KnownTask(60)}, {name: KnownPolicy(frozenset(), None) for name in ("oracle", "random")}, {}
)


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A package from `robogauntlet new adapter`, put on the path as an editable installation would."""
    folder = tmp_path_factory.mktemp("new")
    done = run_gauntlet("new", "adapter", "my-sim", cwd=folder)
    assert done.returncode == 0, done.stderr
    package = folder / "robogauntlet-my-sim"
    built = run_process([sys.executable, "-c", "import setuptools; setuptools.setup()", "-q", "egg_info"], package)
    assert built.returncode == 0, built.stderr
    return package


def test_a_new_adapter_passes_every_check_at_once(package):
    done = run_gauntlet("check", "adapter", "my-sim", cwd=package, paths=[package])
    assert done.returncode == 0, done.stdout + done.stderr
    assert " 0 failed" in done.stdout
    assert "robogauntlet:" not in done.stderr
    assert [policy.kind for policy in load_suite(package / "my-sim.yaml", KNOWN).policies] == ["oracle", "random"]


def test_the_tests_of_a_new_adapter_are_a_test_for_each_check(package):
    pytest_command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    chosen = ["-k", "description or action-dx or table-paint"]
    done = run_process([*pytest_command, *chosen], package, paths=[package])
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 passed, 1 skipped" in done.stdout


def test_an_adapter_that_is_broken_fails_with_a_line_and_exit_code_1(package):
    adapter = package / "robogauntlet_my_sim" / "adapter.py"
    own = adapter.read_text()
    adapter.write_text(own.replace("self._world.step(action[:3],", "self._world.step(-action[:3],"))
    try:
        options = ("--only", "action-d", "--json")
        done = run_gauntlet("check", "adapter", "my-sim", *options, cwd=package, paths=[package])
    finally:
        adapter.write_text(own)
    assert done.returncode == 1
    findings = json.loads(done.stdout)
    assert [finding["outcome"] for finding in findings] == ["failed"] * 6
    assert "(the other sign?)" in findings[0]["seen"]


def test_the_list_shows_versions_tasks_oracles_and_adjustments():
    done = CliRunner().invoke(app, ["list", "simulators"])
    (line,) = [line.split() for line in done.stdout.splitlines() if line.startswith("pybullet")]
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in catalog.find("pybullet").distributions)
    adjusted = ["arm,", "cameras,", "dynamics,", "lights,", "objects,", "table"]
    assert line == ["pybullet", "PyBullet", "(panda-gym)", *versions.split(), "3", "3", *adjusted]


@pytest.mark.parametrize("name", ["MySim", "my sim", "my_sim", "-x", "x-", "1x", "a" * 41, "../up", "maniskill"])
def test_a_bad_name_is_refused_in_one_line_and_nothing_is_written(tmp_path, name):
    with pytest.raises(INPUT_ERRORS) as refused:
        new(name, tmp_path / "folder")
    assert f"'{name}'" in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_package_that_cannot_be_written_is_one_line_and_leaves_nothing(tmp_path):
    with full_disk(), pytest.raises(INPUT_ERRORS, match="cannot be written: File too large"):
        new("mysim", tmp_path / "folder")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_exists_is_left_alone(run_command, tmp_path):
    (tmp_path / "there").mkdir()
    line = run_command("new", "adapter", "mysim", "--out", "there").refusal
    assert line == "there exists; give another folder with --out"
    assert not list((tmp_path / "there").iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "pybulet"}, "unknown simulator 'pybulet'; did you mean 'pybullet'?"),
        ({"task": ["PandaReech-v3"]}, "unknown task 'pybullet/PandaReech-v3'; did you mean 'pybullet/PandaReach-v3'?"),
        ({"only": ["sedes"]}, "unknown check 'sedes'; did you mean 'seeds'?"),
    ],
)
def test_an_unknown_name_gets_a_suggestion(arguments, message):
    with pytest.raises(INPUT_ERRORS) as refused:
        check(**{"name": "pybullet", **arguments})
    assert str(refused.value) == message


@pytest.mark.parametrize("name", ["toysim2", "my-sim", "sim"])
def test_a_name_replaces_the_toys_in_every_form(name):
    module, title = name.replace("-", "_"), "".join(part.capitalize() for part in name.split("-"))
    text = "robogauntlet_toysim toysim/Reach ToysimCameras test_toysim_keeps"
    assert ADAPTER.renamed(text, name) == f"robogauntlet_{module} {name}/Reach {title}Cameras test_{module}_keeps"


TOYS = "tests.adapters.toy_benchmarks"


def test_a_benchmark_of_vla_eval_becomes_a_package_whose_tasks_open_and_repeat(tmp_path):
    pytest.importorskip("vla_eval")
    listed = ("--vla-eval", f"{TOYS}:Pushes", "--control-hz", "10")
    done = run_gauntlet("new", "adapter", "toys", *listed, cwd=tmp_path, paths=[ROOT])
    assert done.returncode == 0, done.stderr
    package = tmp_path / "robogauntlet-toys"
    built = run_process([sys.executable, "-c", "import setuptools; setuptools.setup()", "-q", "egg_info"], package)
    assert built.returncode == 0, built.stderr
    chosen = ("--only", "declaration", "--only", "seeds-images", "--json")
    done = run_gauntlet("check", "adapter", "toys", *chosen, cwd=tmp_path, paths=[package, ROOT])
    assert done.returncode == 0, done.stdout + done.stderr
    found = {(finding["task"], finding["check"], finding["outcome"]) for finding in json.loads(done.stdout)}
    assert ("toys/push-right", "seeds-images", "passed") in found
    assert ("toys/push-left", "declaration", "passed") in found


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--control-hz", "10"), "--arguments and --control-hz: expected --vla-eval beside them, got none"),
        (("--vla-eval", f"{TOYS}:Pushes"), "--control-hz: expected the control steps per simulated second.*got none"),
        (
            ("--vla-eval", f"{TOYS}:Pushes", "--control-hz", "10", "--arguments", "[1]"),
            r"--arguments: expected a JSON object, such as '\{.*\}', got '\[1\]'",
        ),
        (("--vla-eval", f"{TOYS}:Pushs", "--control-hz", "10"), "no such class in that module.*did you mean 'Pushes'"),
        (("--vla-eval", "pushes", "--control-hz", "10"), "pushes: expected a module of this name in .*, found none"),
        (("--vla-eval", f"{TOYS}:NeedsItsSimulator", "--control-hz", "10"), "cannot import .*no_such_simulator"),
    ],
)
def test_a_benchmark_that_cannot_be_listed_is_one_line_and_nothing_is_written(run_command, tmp_path, options, says):
    pytest.importorskip("vla_eval")
    assert re.search(says, run_command("new", "adapter", "toys", *options).refusal)
    assert not list(tmp_path.iterdir())
