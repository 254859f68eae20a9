"""Which Python and which release `env create` takes, and that it says so."""

import sys

import pytest

from robogauntlet.orchestrator.environments import installer
from robogauntlet.orchestrator.environments.environment import (
    MARKER,
    RUNNING,
    EnvironmentProblem,
    declared_environments,
    environment_users,
)
from robogauntlet.orchestrator.environments.pythons import find_python
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver


@pytest.fixture
def pretended(tmp_path, monkeypatch):
    """Returns a function that writes a program which pretends to be `python3.12`; only those are found."""
    monkeypatch.setenv("PATH", f"{tmp_path / 'first'}:{tmp_path / 'second'}:/bin")
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))

    def write(folder, does):
        (tmp_path / folder).mkdir(parents=True)
        python = tmp_path / folder / "python3.12"
        python.write_text(f"#!/bin/sh\n{does}\n")
        python.chmod(0o755)
        return python

    return write


@pytest.fixture
def create(run_command, monkeypatch, tmp_path):
    """Returns a function that types `env create lerobot`, which stops before anything is made, and what it printed."""
    monkeypatch.setenv("ROBOGAUNTLET_ENVIRONMENTS", str(tmp_path / "environments"))

    def stop(environment, log, fresh):
        raise EnvironmentProblem(f"would make {environment.entry.python}")

    monkeypatch.setattr(installer, "create", stop)
    return lambda: run_command("env", "create", "lerobot")


def test_the_running_python_is_at_hand():
    assert str(find_python(RUNNING)) == sys.executable


def test_a_python_that_does_not_start_or_is_another_is_passed_over(pretended):
    pretended("first", "echo command not found >&2; exit 127")  # as a shim of pyenv does
    pretended("second", "echo 3.10")
    assert find_python("3.12") is None
    last = pretended("pyenv/versions/3.12.9/bin", "echo 3.12")
    assert find_python("3.12") == last


@pytest.mark.skipif(RUNNING != "3.11", reason="this machine's Python is newer")
def test_a_newer_python_gets_a_newer_lerobot_and_a_line_says_so(pretended, create):
    python = pretended("second", "echo 3.12")
    done = create()
    assert done.out.splitlines() == [f"lerobot: lerobot[diffusion,pi,smolvla]==0.6.1 with Python 3.12, {python}"]
    assert "would make 3.12" in done.err


@pytest.mark.skipif(RUNNING != "3.11", reason="this machine's Python is newer")
def test_without_a_newer_python_an_older_lerobot_is_made_and_a_line_says_why(pretended, create):
    pretended("first", "exit 127")
    done = create()
    _, taken, why = done.out.rstrip().split(": ", 2)
    assert taken == f"lerobot==0.4.4 with Python 3.11, {sys.executable}"
    needed = "lerobot[diffusion,pi,smolvla]==0.6.1 needs Python 3.12 or 3.13"
    assert why == f"{needed}, and none that starts is on the PATH or in pyenv"
    assert "would make None" in done.err


def test_runs_use_the_preferred_environment_of_those_that_were_made(run_command, monkeypatch, tmp_path):
    monkeypatch.setenv("ROBOGAUNTLET_ENVIRONMENTS", str(tmp_path))
    kind = environment_users()["lerobot"]
    used = []
    for environment in reversed(declared_environments(kind)):
        environment.folder.mkdir()
        (environment.folder / MARKER).write_text("{}")
        used.append(EnvironmentResolver().resolve(kind).version)
    assert used == [RUNNING, "3.13", "3.12"]
    assert '"requirements": ["lerobot[diffusion,pi,smolvla]==0.6.1"]' in run_command("env", "list", "lerobot").out
