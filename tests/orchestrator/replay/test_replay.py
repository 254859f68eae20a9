"""Rows replayed in one process per simulator."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import SimulatorUnavailable
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.video_recorder import VideoRecorder
from robogauntlet.orchestrator.ray_runtime.simulator_processes import ProcessEnded, run_in_simulator_environment
from robogauntlet.orchestrator.replay.replay import NotReplayed, differences, replay_rows
from tests.results.synthetic import cells, row

ROWS = [row(cell, seed) for seed in range(2) for cell in cells(("p",), ("maniskill/A", "pybullet/B"))]


def test_each_row_gets_its_own_result_or_the_reason_why_its_simulator_gave_none(monkeypatch):
    def run_per_simulator(generator, arguments, environments, time_s):
        assert {name: {row.simulator for row in rows} for name, (_, rows, _) in arguments.items()} == {
            "maniskill": {"maniskill"},
            "pybullet": {"pybullet"},
        }
        yield "maniskill", "first"
        yield "pybullet", ProcessEnded("not installed")
        yield "maniskill", "second"

    monkeypatch.setattr(
        "robogauntlet.orchestrator.ray_runtime.simulator_processes.run_per_simulator", run_per_simulator
    )
    found = [(row.task, row.seed, result) for row, result in replay_rows(ROWS, {}, EnvironmentResolver(), print)]
    missing = NotReplayed("pybullet", "not installed")
    assert found == [
        ("maniskill/A", 0, "first"),
        ("pybullet/B", 0, missing),
        ("pybullet/B", 1, missing),
        ("maniskill/A", 1, "second"),
    ]


MEASURED = {"path_length": 1.25, "contact_steps": 3, "failure": "dropped"}


def test_behaviour_is_compared_with_a_row_that_has_it():
    stored = row(cells()[0], 0, "failure", **MEASURED)
    assert differences(stored, replace(stored)) == ()
    assert differences(stored, replace(stored, path_length=1.5, failure=None)) == (
        "path_length: stored 1.25, now 1.5",
        'failure: stored "dropped", now null',
    )


def squares(count):
    yield from (number**2 for number in range(count))


def test_a_simulator_of_this_environment_runs_in_this_process():
    assert run_in_simulator_environment(squares, catalog.find("null"), (3,), EnvironmentResolver()) == [0, 1, 4]


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_an_environment_that_does_not_fit_is_reported_without_starting_a_process(monkeypatch):
    monkeypatch.setattr(EnvironmentResolver, "resolve", lambda environments, simulator: "elsewhere")
    monkeypatch.setattr(EnvironmentResolver, "missing_reason", lambda environments, simulator: "not created")
    with pytest.raises(SimulatorUnavailable, match="null: not created"):
        run_in_simulator_environment(squares, catalog.find("null"), (3,), EnvironmentResolver())


SHOWN = SimpleNamespace(picture=lambda: np.zeros((256, 256, 3), np.uint8), action_spec=SimpleNamespace(control_hz=20))


def record(path, *, interrupted):
    with VideoRecorder(path, steps=10) as recorder:
        for step in range(10):
            recorder(SHOWN, step)
        if interrupted:
            raise KeyboardInterrupt


def test_only_a_complete_video_has_its_name(tmp_path):
    path = tmp_path / "videos" / "a.mp4"
    with pytest.raises(KeyboardInterrupt):
        record(path, interrupted=True)
    assert not path.exists()
    record(path, interrupted=False)
    assert [file.name for file in path.parent.iterdir()] == ["a.mp4"]


@pytest.mark.parametrize(("control_hz", "steps", "frames"), [(20, 40, 21), (25, 40, 21), (20, 240, 61), (5, 40, 41)])
def test_a_video_has_about_ten_frames_a_second_and_at_most_about_sixty(tmp_path, control_hz, steps, frames):
    drawn = []
    shown = SimpleNamespace(
        picture=lambda: drawn.append(0) or np.zeros((256, 256, 3), np.uint8),
        action_spec=SimpleNamespace(control_hz=control_hz),
    )
    with VideoRecorder(tmp_path / "a.mp4", steps=steps) as recorder:
        for step in range(steps + 1):
            recorder(shown, step)
    assert len(drawn) == frames
