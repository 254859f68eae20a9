"""An environment is complete or does not exist, and a failure is one line."""

import contextlib
import os
import signal
import subprocess
import time
from dataclasses import replace

import psutil
import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.environments import installer
from robogauntlet.orchestrator.environments.check import check
from robogauntlet.orchestrator.environments.environment import RUNNING, EnvironmentProblem, root
from tests.errors import one_line_error
from tests.full_disk import no_space
from tests.processes import GAUNTLET

BACKEND = """
import pathlib, time

def build_wheel(*arguments):
    pathlib.Path("begun").touch()
    time.sleep(600)

build_editable = prepare_metadata_for_build_wheel = build_wheel
"""
PROJECT = '[build-system]\nrequires = []\nbuild-backend = "backend"\nbackend-path = ["."]\n'


def silent(line):
    pass


def leftovers():
    return [path.name for path in root().iterdir() if path.is_dir()]


def test_its_packages_shadow_inherited_ones_and_it_is_created_once(environment):
    one = environment(requirements=["gearbox==2.0"])
    assert installer.create(one, silent)
    found = check(one, catalog.find("bare"))
    assert (found.problems, found.versions["gearbox"]) == ((), "2.0")
    assert not installer.create(one, silent)


def test_another_entry_is_another_environment(environment):
    assert environment(requirements=["gearbox==1.0"]).folder != environment(requirements=["gearbox==2.0"]).folder


def test_a_fresh_environment_replaces_the_old_one(environment):
    one = environment()
    installer.create(one, silent)
    before = one.folder.resolve()
    assert installer.create(one, silent, fresh=True)
    assert one.folder.resolve() != before
    assert not before.exists()


@pytest.mark.parametrize(
    ("requirement", "reason"),
    [
        ("nonesuch-package==9", "Could not find a version that satisfies the requirement nonesuch-package==9"),
        ("ray==1.0", "Cannot install ray==1.0"),
    ],
)
def test_a_failed_installation_is_one_line_and_leaves_nothing(environment, requirement, reason):
    one = environment(requirements=[requirement])
    with pytest.raises(EnvironmentProblem) as caught:
        installer.create(one, silent)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)
    assert leftovers() == []


def test_the_environment_of_a_policy_gets_its_requirements_alone(environment):
    """Not Ray, nor what workers import: none of it can be found here."""
    one = replace(environment(requirements=["gearbox==1.0"], inherit=False), name="lerobot")
    assert installer.create(one, silent)
    assert [path.name for path in one.site_packages[0].glob("*.dist-info")] == ["gearbox-1.0.dist-info"]


@pytest.mark.parametrize(
    ("inherit", "reason"),
    [
        (True, f"expected Python {RUNNING} as here, or inherit: false, got python: 3.19"),
        (False, "no Python 3.19 that starts is on the PATH or in pyenv"),
    ],
)
def test_a_python_that_a_policy_cannot_have_is_one_line(environment, inherit, reason):
    with one_line_error(EnvironmentProblem, f"^lerobot: {reason}$"):
        installer.create(replace(environment(python="3.19", inherit=inherit), name="lerobot"), silent)
    assert installer.all_folders() == []


def test_a_failed_replacement_leaves_the_old_one(environment, monkeypatch):
    one = environment(requirements=["gearbox==2.0"])
    installer.create(one, silent)
    monkeypatch.delenv("PIP_FIND_LINKS")
    with pytest.raises(EnvironmentProblem):
        installer.create(one, silent, fresh=True)
    assert check(one, catalog.find("bare")).problems == ()


def test_a_full_disk_is_reported_and_leaves_nothing(environment, monkeypatch):
    monkeypatch.setattr(installer, "_run", no_space)
    with pytest.raises(EnvironmentProblem, match="the disk is full"):
        installer.create(environment(), silent)
    assert leftovers() == []


def test_a_full_disk_in_an_installers_output_is_reported():
    output = ["Collecting x", "ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device"]
    assert installer.reason(output).startswith("the disk is full")


def test_the_last_reason_of_uv_is_reported():
    output = ["error: No solution found when resolving dependencies", "Caused by: Because gearbox was not found", ""]
    assert installer.reason(output).endswith("the installer failed: Because gearbox was not found")


def test_another_python_is_refused_before_anything_is_created(environment):
    with pytest.raises(EnvironmentProblem, match=r"expected Python 3\.\d+ as here.*got python: 3\.19"):
        installer.create(environment(python="3.19"), silent)
    assert not root().exists()


def test_missing_uv_is_one_line(environment, monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(EnvironmentProblem, match="expected uv on the PATH, found none"):
        installer.create(environment(installer="uv", inherit=False), silent)


def test_an_environment_is_created_by_one_process_at_a_time(environment):
    one = environment()
    root().mkdir(parents=True)
    with installer._locked(one.folder), pytest.raises(EnvironmentProblem, match="another process is creating it"):
        installer.create(one, silent)


@pytest.mark.parametrize(("by", "left"), [(signal.SIGINT, False), (signal.SIGKILL, True)])
def test_an_interrupted_creation_leaves_no_usable_environment(environment, tmp_path, by, left):
    slow = tmp_path / "slow"
    slow.mkdir()
    (slow / "backend.py").write_text(BACKEND)
    (slow / "pyproject.toml").write_text(PROJECT)
    suite = tmp_path / "suite.yaml"
    entry = f"{{bare: {{requirements: ['{slow}']}}}}"
    suite.write_text(f"name: s\npolicies: [zero]\ntasks: [bare/Reach]\nseeds: {{count: 1}}\nenvironments: {entry}\n")
    command = [*GAUNTLET, "env", "create", "bare", "--suite", str(suite)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True)
    try:
        deadline = time.monotonic() + 120
        while not (slow / "begun").exists():
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        children = psutil.Process(process.pid).children(recursive=True)
        os.kill(process.pid, by)
        process.communicate(timeout=60)
    finally:
        process.kill()
        for child in children:
            with contextlib.suppress(psutil.NoSuchProcess):
                child.kill()
    one = environment(requirements=[str(slow)])
    assert one.manifest is None
    assert bool(leftovers()) is left
    assert [folder.name for folder in installer.all_folders()] == ([one.folder.name] if left else [])
    assert installer.remove("bare") == ([one.folder] if left else [])
    assert leftovers() == []
