"""A run that an experiment tracker observes, and trackers that misbehave."""

import contextlib
import os
import re
import socket
import sqlite3
import sys
import time

import pytest

import robogauntlet
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.trackers import open_tracker, tracker
from robogauntlet.orchestrator.trackers.tracked_run import TrackerError, tracked_run
from robogauntlet.orchestrator.trackers.tracker import progress_metrics
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.store.history_records import Counts
from tests.orchestrator.runs.playing import observer, play, state_of
from tests.orchestrator.trackers.runs import items, require, wandb_records
from tests.results.synthetic import copied_run

require("wandb,mlflow", "wandb", "mlflow", "alembic")
SUITE = """
name: nights
policies: [oracle, random]
tasks: [null/Slow]
seeds: {count: 8}
workers: 1
"""
NOWHERE = "http://127.0.0.1:9"


@pytest.fixture(autouse=True)
def alone(tmp_path, monkeypatch):
    """An empty folder, no login and no settings of a tracker, and a suite."""
    for name in [name for name in os.environ if name.startswith(("WANDB_", "MLFLOW_"))]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "suite.yaml").write_text(SUITE)
    monkeypatch.setattr(tracker, "UPDATE_S", 0.2)


@pytest.fixture
def offline(monkeypatch):
    """W&B writes files; it keeps the settings with which it was first used in a process."""
    import wandb

    wandb.teardown()
    monkeypatch.setenv("WANDB_MODE", "offline")
    yield
    wandb.teardown()


@pytest.fixture
def silent_server():
    """The address of a server that takes requests and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"http://127.0.0.1:{server.getsockname()[1]}"


@pytest.fixture(scope="module")
def untracked(tmp_path_factory, ray_here):
    """A run folder of the suite, played without a tracker, and its rows hash."""
    folder = tmp_path_factory.mktemp("untracked")
    (folder / "suite.yaml").write_text(SUITE)
    return folder / "run", play(folder / "suite.yaml", folder / "run").document.rows_hash


@pytest.fixture
def expected(untracked):
    """The status and the rows hash of the suite, whatever becomes of the tracker."""
    return RunStatus.COMPLETE, untracked[1]


@pytest.fixture
def played(tmp_path, untracked):
    """A folder in which the whole suite was played without a tracker: nothing is left but to send it."""
    copied_run(untracked[0], tmp_path / "run")


def ended(outcome):
    return outcome.document.status, outcome.document.rows_hash


def tracked_play(folder, name, *others, **options):
    """The outcome, and what the tracker said."""
    said = []
    observers = [open_tracker(name, "nights", said.append), *others]
    return play(folder / "suite.yaml", folder / "run", observers=observers, **options), said


@pytest.mark.ray
@pytest.mark.usefixtures("offline")
def test_wandb_receives_progress_and_at_the_end_what_log_sends(tmp_path, expected):
    outcome, said = tracked_play(tmp_path, "wandb")
    assert ended(outcome) == expected
    assert outcome.warnings == []
    assert [line.partition(" with: ")[0] for line in said] == ["logging: upload it", "logged: upload it"]
    (path,) = tmp_path.glob("wandb/offline-run-*/*.wandb")
    history = [items(record.history.item) for record in wandb_records(path) if record.HasField("history")]
    last = {name: value for moment in history for name, value in moment.items()}
    assert (last["progress/done"], last["progress/planned"], last["progress/errors"]) == (16, 16, 0)
    assert (last["progress/success_rate/oracle"], last["progress/success_rate/random"]) == (1, 0)
    assert last["progress/success_rate_low/oracle"] < 1 < last["progress/n/oracle"]
    assert not [name for name in last if re.fullmatch(r"progress/success_rate(/all)?", name)]
    opened = robogauntlet.open_run(tmp_path / "run")
    expected = tracked_run(opened.document, opened.tables()).metrics
    assert {name: last.get(name) for name in expected} == expected
    assert "cells/_type" in last or "cells" in last


def interrupt(rows):
    raise KeyboardInterrupt


@pytest.mark.nightly
@pytest.mark.ray
def test_an_interrupted_run_ends_in_mlflow_and_is_continued_there_with_its_videos(tmp_path, monkeypatch, expected):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path / 'mlflow.db'}")

    def the_run():
        """Id, status and metrics of the only run of the experiment, from the database: a client takes seconds."""
        with contextlib.closing(sqlite3.connect(tmp_path / "mlflow.db")) as database:
            query = (
                "SELECT run_uuid, status FROM runs JOIN experiments USING (experiment_id) WHERE experiments.name = ?"
            )
            ((run, status),) = database.execute(query, ["nights"])
            metrics = database.execute("SELECT key, value FROM latest_metrics WHERE run_uuid = ?", [run])
            return run, status, dict(metrics)

    outcome, _ = tracked_play(tmp_path, "mlflow", observer(on_rows=interrupt))
    assert (outcome.document.status, outcome.warnings) == (RunStatus.INTERRUPTED, [])
    first, status, metrics = the_run()
    assert (status, metrics["progress/done"]) == ("KILLED", outcome.done)
    outcome, _ = tracked_play(tmp_path, "mlflow", media=True)
    assert ended(outcome) == expected
    run, status, metrics = the_run()
    assert (run, status, metrics["progress/done"]) == (first, "FINISHED", 16)
    assert metrics["success_rate/oracle/null/Slow"] == 1.0
    assert metrics["n/all"] == 16
    videos = {str(path).partition("artifacts/")[2] for path in tmp_path.glob("mlruns/*/*/artifacts/videos/*/*/*/*")}
    assert videos == {"videos/oracle/null/Slow/success.mp4", "videos/random/null/Slow/failure.mp4"}


@pytest.mark.ray
def test_a_server_that_never_answers_costs_one_warning_and_a_moment(tmp_path, monkeypatch, silent_server, expected):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", silent_server)
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_TIMEOUT", "1")
    began, opened = time.monotonic(), []
    later = observer(on_start=lambda run: opened.append(time.monotonic()))
    outcome, said = tracked_play(tmp_path, "mlflow", later)
    assert opened[0] - began < 20
    assert ended(outcome) == expected
    (warning,) = outcome.warnings
    command = f"robogauntlet export {tmp_path / 'run'} --tracker mlflow --project 'nights'"
    assert warning.startswith("MLflow did not accept the run (")
    assert warning.endswith(f"; the run goes on, to send its results later: {command}")
    assert said == []


@pytest.mark.ray
@pytest.mark.usefixtures("played")
@pytest.mark.parametrize("address", [NOWHERE, "sqlite:///suite.yaml/mlflow.db", "no-such-scheme://x"])
def test_a_tracker_that_refuses_the_run_costs_one_warning(tmp_path, monkeypatch, expected, address):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", address)
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    outcome, _ = tracked_play(tmp_path, "mlflow")
    assert ended(outcome) == expected
    (warning,) = outcome.warnings
    assert warning.startswith("MLflow did not accept the run (")


def test_progress_is_sent_as_counts_pace_and_rates_of_each_policy_and_condition(tmp_path):
    (tmp_path / "noise.yaml").write_text(SUITE + 'conditions: [clean, "noise@2"]\n')
    plan = make_plan(tmp_path / "noise.yaml")
    oracle, noise = plan.cells[0].policy_digest, ("noise", 2)
    stored = {(oracle, "null/Slow", "clean", 0): Counts(0, 3, 1), (oracle, "null/Slow", *noise): Counts(0, 0, 0, 2)}
    metrics = progress_metrics(state_of(plan, stored).progress)
    assert (metrics["progress/done"], metrics["progress/planned"], metrics["progress/errors"]) == (6, 32, 2)
    assert "progress/episodes_per_minute/null" not in metrics
    assert [name for name in metrics if "success_rate/" in name] == ["progress/success_rate/oracle"]
    assert (metrics["progress/success_rate/oracle"], metrics["progress/n/oracle"]) == (0.75, 4)
    assert 0.3 < metrics["progress/success_rate_low/oracle"] < 0.75 < metrics["progress/success_rate_high/oracle"] < 1


def test_a_tracker_that_does_not_exist_is_refused():
    with pytest.raises(TrackerError, match="expected an experiment tracker, wandb or mlflow, got 'wandbb'"):
        robogauntlet.evaluate("oracle", "null/Reach", tracker="wandbb")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("--tracker", "wandbb"), "tracker: expected an experiment tracker, wandb or mlflow, got 'wandbb'"),
        (("--tracker", "wandb"), "W&B has no login; log in with `wandb login`, or write files with WANDB_MODE=offline"),
        (("--tracker", "mlflow", "--project", "a/b"), "the project's name: expected at most 128 letters"),
    ],
)
def test_a_mistake_is_one_line_before_anything_starts(run_command, tmp_path, arguments, line):
    done = run_command("run", "suite.yaml", "--out", "run", *arguments)
    assert line in done.refusal
    assert done.out == ""
    assert not (tmp_path / "run").exists()


def test_a_library_that_is_missing_is_one_line_before_anything_starts(run_command, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    done = run_command("run", "suite.yaml", "--tracker", "wandb")
    assert done.refusal == 'W&B is not installed; install it with: pip install "robogauntlet[wandb]"'
