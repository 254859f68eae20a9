"""A run that is sent to an experiment tracker while it plays, and trackers that misbehave."""

import contextlib
import os
import re
import signal
import socket
import sqlite3
import time

import psutil
import pytest

import robogauntlet
from robogauntlet.orchestrator.runs.progress import Progress
from robogauntlet.orchestrator.trackers import live_tracker
from robogauntlet.orchestrator.trackers.live_tracker import LiveTracker
from robogauntlet.orchestrator.trackers.tracked_run import TrackerError, tracked_run
from robogauntlet.orchestrator.trackers.tracker import Tracker, read_tracker
from robogauntlet.results.run_document import RunStatus
from robogauntlet.support.secret_variables import SECRETS
from tests import ROOT
from tests.full_disk import full_disk
from tests.orchestrator.runs.playing import play
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
    monkeypatch.setattr(live_tracker, "UPDATE_S", 0.2)


@pytest.fixture
def patient(monkeypatch):
    """A tracker on a busy machine is waited for."""
    monkeypatch.setattr(live_tracker, "END_S", 120.0)


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


def tracked_play(folder, tracker, **options):
    return play(folder / "suite.yaml", folder / "run", tracker=LiveTracker(tracker, "nights"), **options)


def interrupting(monkeypatch):
    """Ctrl-C after the first rows, once."""
    on_results = Progress.on_results

    def interrupt(self, results):
        monkeypatch.setattr(Progress, "on_results", on_results)
        on_results(self, results)
        raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "on_results", interrupt)


@pytest.mark.ray
def test_wandb_receives_progress_and_at_the_end_what_log_sends(tmp_path, monkeypatch, expected, patient):
    monkeypatch.setenv("WANDB_MODE", "offline")
    outcome = tracked_play(tmp_path, Tracker.WANDB)
    assert ended(outcome) == expected
    assert outcome.warnings == []
    assert outcome.logged.startswith("upload it with: wandb sync")
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


@pytest.mark.ray
def test_an_interrupted_run_ends_in_mlflow_and_is_continued_there_with_its_videos(
    tmp_path, monkeypatch, expected, patient
):
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

    interrupting(monkeypatch)
    outcome = tracked_play(tmp_path, Tracker.MLFLOW)
    assert (outcome.document.status, outcome.warnings) == (RunStatus.INTERRUPTED, [])
    first, status, metrics = the_run()
    assert (status, metrics["progress/done"]) == ("KILLED", outcome.done)
    outcome = tracked_play(tmp_path, Tracker.MLFLOW, media=True)
    assert ended(outcome) == expected
    run, status, metrics = the_run()
    assert (run, status, metrics["progress/done"]) == (first, "FINISHED", 16)
    assert metrics["success_rate/oracle/null/Slow"] == 1.0
    assert metrics["n/all"] == 16
    videos = {str(path).partition("artifacts/")[2] for path in tmp_path.glob("mlruns/*/*/artifacts/videos/*/*/*/*")}
    assert videos == {"videos/oracle/null/Slow/success.mp4", "videos/random/null/Slow/failure.mp4"}


def check_unanswered(folder, tracker, expected):
    """Play with a tracker that never answers, which costs one warning and a moment."""
    numbers = []
    outcome = play(
        *(folder / "suite.yaml", folder / "run"),
        tracker=tracker,
        on_numbers=lambda outcome: numbers.append(time.monotonic()),
    )
    assert time.monotonic() - numbers[0] < 5.0
    assert ended(outcome) == expected
    (warning,) = outcome.warnings
    assert "\n" not in warning
    command = f"robogauntlet log {folder / 'run'} --to mlflow"
    assert re.search(rf"(within|did not answer).*; the run goes on, to send its results later: {command}", warning)
    assert outcome.logged is None


@pytest.mark.ray
def test_a_tracker_that_never_answers_costs_one_warning_and_a_moment(tmp_path, monkeypatch, silent_server, expected):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", silent_server)
    tracker = LiveTracker(Tracker.MLFLOW)
    monkeypatch.setattr(live_tracker, "ANSWER_S", 0.5)
    monkeypatch.setattr(live_tracker, "END_S", 1.0)
    check_unanswered(tmp_path, tracker, expected)


@pytest.mark.ray
@pytest.mark.usefixtures("played")
def test_a_run_does_not_wait_at_its_end_for_a_tracker_that_may_still_answer(
    tmp_path, monkeypatch, silent_server, expected
):
    monkeypatch.setenv("MLFLOW_TRACKING_URI", silent_server)
    monkeypatch.setattr(live_tracker, "END_S", 1.0)
    check_unanswered(tmp_path, LiveTracker(Tracker.MLFLOW), expected)


def check_refused(folder, monkeypatch, address, expected):
    """Play with an address that MLflow refuses, which costs one warning."""
    monkeypatch.setenv("MLFLOW_TRACKING_URI", address)
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    monkeypatch.setattr(live_tracker, "END_S", 60.0)
    outcome = tracked_play(folder, Tracker.MLFLOW)
    assert ended(outcome) == expected
    (warning,) = outcome.warnings
    assert warning.startswith("MLflow did not accept the run (")


@pytest.mark.ray
def test_a_tracker_that_raises_while_a_run_plays_costs_one_warning(tmp_path, monkeypatch, expected):
    check_refused(tmp_path, monkeypatch, NOWHERE, expected)


@pytest.mark.ray
@pytest.mark.usefixtures("played")
@pytest.mark.parametrize("address", ["sqlite:///suite.yaml/mlflow.db", "no-such-scheme://x"])
def test_a_tracker_that_raises_costs_one_warning(tmp_path, monkeypatch, expected, address):
    check_refused(tmp_path, monkeypatch, address, expected)


@pytest.mark.ray
def test_a_tracker_whose_process_dies_costs_one_warning(tmp_path, monkeypatch, expected):
    monkeypatch.setenv("WANDB_MODE", "offline")
    on_results = Progress.on_results

    def kill(self, results):
        on_results(self, results)
        with contextlib.suppress(ProcessLookupError):
            os.kill(tracker._child._process.pid, signal.SIGKILL)

    monkeypatch.setattr(Progress, "on_results", kill)
    tracker = LiveTracker(Tracker.WANDB)
    outcome = play(tmp_path / "suite.yaml", tmp_path / "run", tracker=tracker)
    assert ended(outcome) == expected
    (warning,) = outcome.warnings
    assert warning.startswith("W&B: the process was killed by SIGKILL")


@pytest.mark.ray
@pytest.mark.usefixtures("played")
@pytest.mark.parametrize("name", Tracker)
def test_a_tracker_whose_disk_is_full_costs_one_warning(tmp_path, monkeypatch, expected, name):
    monkeypatch.setenv("WANDB_MODE", "offline")
    with full_disk():
        tracker = LiveTracker(name)  # the limit holds in its process
    outcome = play(tmp_path / "suite.yaml", tmp_path / "run", tracker=tracker)
    assert ended(outcome) == expected
    assert (len(outcome.warnings), outcome.logged) == (1, None)


def test_the_process_of_a_tracker_has_its_secrets_and_no_other(monkeypatch):
    for name in SECRETS:
        monkeypatch.setenv(name, "0123456789" * 4)
    with LiveTracker(Tracker.WANDB) as tracker:
        environment = psutil.Process(tracker._child._process.pid).environ()
    assert {name for name in SECRETS if name in environment} == {"WANDB_API_KEY"}


def test_the_process_of_a_tracker_ends_with_its_block(monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "offline")
    with LiveTracker(Tracker.WANDB) as tracker:
        process = psutil.Process(tracker._child._process.pid)
        assert process.is_running()
    assert not process.is_running()


def test_a_tracker_that_does_not_exist_is_refused():
    with pytest.raises(TrackerError, match="expected an experiment tracker, wandb or mlflow, got 'wandbb'"):
        read_tracker("wandbb")
    with pytest.raises(TrackerError, match="expected an experiment tracker"):
        robogauntlet.evaluate("oracle", "null/Reach", log="wandbb")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("--log", "wandbb"), "log: expected an experiment tracker, wandb or mlflow, got 'wandbb'"),
        (("--log", "wandb"), "W&B has no login; log in with `wandb login`, or write files with WANDB_MODE=offline"),
        (("--log", "mlflow", "--log-project", "a/b"), "the project's name: expected at most 128 letters"),
    ],
)
def test_a_mistake_is_one_line_before_anything_starts(run_command, tmp_path, arguments, line):
    done = run_command("run", "suite.yaml", "--out", "run", *arguments)
    assert line in done.refusal
    assert done.out == ""
    assert not (tmp_path / "run").exists()


def test_a_library_that_is_missing_is_one_line_before_anything_starts(run_command, tmp_path, monkeypatch):
    (tmp_path / "none").mkdir()
    (tmp_path / "none" / "wandb.py").write_text("raise ImportError\n")
    monkeypatch.setenv("PYTHONPATH", f"{ROOT / 'src'}{os.pathsep}{tmp_path / 'none'}")
    done = run_command("run", "suite.yaml", "--log", "wandb")
    assert done.refusal == 'W&B is not installed; install it with: pip install "robogauntlet[wandb]"'
