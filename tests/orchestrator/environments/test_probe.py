"""Checks in a child process whether simulators work; runs skip or require them."""

import json

import pytest

from robogauntlet.orchestrator.cli.common import EXIT_BAD_INPUT
from robogauntlet.orchestrator.environments.probe import probe
from tests.processes import run_gauntlet

pytestmark = pytest.mark.simulator
SUITE = "name: two\npolicies: [zero]\ntasks: [null/Reach, robosuite/Lift]\nseeds: {count: 2}\nhorizon: 8\n"


def test_a_working_simulator_has_version_device_and_frame_time():
    (found,) = probe(["pybullet"])
    assert (found.problem, found.render_device) == (None, "TinyRenderer")
    assert found.versions["pybullet"] == "3.2.7"
    assert found.frame_ms > 0


def test_a_simulator_that_cannot_render_has_a_reason(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    (found,) = probe(["robosuite"])
    assert found.problem.startswith("SimulatorUnavailable: MuJoCo cannot render with MUJOCO_GL=nonsense")
    assert "\n" not in found.problem


def test_a_process_that_dies_is_a_finding(monkeypatch):
    monkeypatch.setattr("sys.executable", "/bin/false")
    (found,) = probe(["pybullet"])
    assert found.problem == "the process ended with code 1: no message"


@pytest.fixture
def blind(tmp_path):
    """Runs the command where MuJoCo cannot render."""
    suite = tmp_path / "suite.yaml"
    suite.write_text(SUITE)

    def run(*arguments):
        return run_gauntlet(*arguments, cwd=tmp_path, MUJOCO_GL="nonsense")

    return run


def test_a_required_simulator_that_cannot_render_ends_the_run_before_it_starts(blind, tmp_path):
    done = blind("run", "suite.yaml", "--out", tmp_path / "run", "--require", "robosuite")
    assert done.returncode == EXIT_BAD_INPUT
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("robogauntlet: robosuite: SimulatorUnavailable: MuJoCo cannot render")
    assert not (tmp_path / "run").exists()


@pytest.mark.ray
def test_a_simulator_that_cannot_render_is_skipped_named_and_shown_in_the_report(blind, tmp_path):
    done = blind("run", "suite.yaml", "--out", tmp_path / "run", "--no-media")
    assert done.returncode == 0, done.stderr
    assert "robosuite is skipped (2 episodes): MuJoCo cannot render with MUJOCO_GL=nonsense" in done.stderr
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    assert document["skipped"]["robosuite"].startswith("MuJoCo cannot render")
    assert "MuJoCo cannot render" in (tmp_path / "run" / "report.html").read_text()
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["total"]["missing"] == 2


def test_the_doctor_names_what_is_broken_and_what_works(blind):
    done = blind("check", "installation")
    assert done.returncode == 1
    assert "robogauntlet: robosuite: SimulatorUnavailable: MuJoCo cannot render" in done.stderr
    assert "TinyRenderer" in done.stdout
