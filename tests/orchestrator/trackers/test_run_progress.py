"""What a tracker receives while a run plays, and which videos."""

import pytest

from robogauntlet.orchestrator.trackers import videos
from robogauntlet.orchestrator.trackers.run_progress import RunProgress
from robogauntlet.orchestrator.trackers.videos import tracked_videos
from robogauntlet.results.live_status import LiveSimulator
from robogauntlet.results.media_paths import video_path
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, row

NORMAL, NOISE = Condition(), Condition("noise", 2)
CELLS = cells(("a", "b"), ("null/Reach", "null/Slow"), (NORMAL, NOISE))
SIMULATORS = (
    LiveSimulator(simulator="null", planned=40, successes=6, failures=3, errors=1, per_minute=12.5),
    LiveSimulator(simulator="pybullet", planned=2, successes=0, failures=0, errors=0),
)


def rows(status, count, policy="a", condition=NORMAL):
    chosen = [cell for cell in CELLS if (cell.policy, cell.condition) == (policy, condition)]
    return [row(chosen[0], seed, status) for seed in range(count)]


@pytest.fixture
def progress():
    return RunProgress(document(20, CELLS), {})


def test_counts_and_the_pace_of_each_simulator_are_sent(progress):
    metrics = progress.metrics(SIMULATORS)
    assert (metrics["progress/done"], metrics["progress/planned"], metrics["progress/errors"]) == (10, 42, 1)
    assert metrics["progress/episodes_per_minute/null"] == 12.5
    assert "progress/episodes_per_minute/pybullet" not in metrics


def test_policies_and_conditions_are_never_pooled(progress):
    progress.count([*rows("success", 3), *rows("failure", 1), *rows("failure", 2, condition=NOISE)])
    progress.count([*rows("success", 5, policy="b"), *rows("error", 4, policy="b")])
    metrics = progress.metrics(SIMULATORS)
    rates = {name: value for name, value in metrics.items() if name.startswith("progress/success_rate/")}
    assert rates == {
        "progress/success_rate/a": 0.75,
        "progress/success_rate/a/noise/2": 0.0,
        "progress/success_rate/b": 1.0,
    }
    assert metrics["progress/n/b"] == 5
    assert 0.3 < metrics["progress/success_rate_low/a"] < 0.75 < metrics["progress/success_rate_high/a"] < 1


def test_a_policy_without_a_success_or_failure_has_no_rate(progress):
    progress.count(rows("error", 4))
    assert not [name for name in progress.metrics(SIMULATORS) if "success_rate" in name]


def test_a_continued_run_counts_the_rows_that_it_has():
    digest = CELLS[0].policy_digest
    progress = RunProgress(document(20, CELLS), {(digest, "null/Reach", "clean", 0): {0: "success", 1: "failure"}})
    progress.count(rows("success", 2))
    assert progress.metrics(SIMULATORS)["progress/success_rate/a"] == 0.75


def save_videos(folder, recorded, size=10):
    for it in recorded:
        path = video_path(folder, it.episode_id)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(size))


def test_a_success_and_a_failure_of_each_policy_and_task_are_sent(tmp_path):
    played = [*rows("success", 3), *rows("failure", 2, policy="b"), *rows("error", 1, policy="b")]
    save_videos(tmp_path, played)
    found = tracked_videos(tmp_path, lambda: played)
    assert sorted(video.name for video in found) == ["a/null/Reach/success", "b/null/Reach/failure"]


def test_videos_are_bounded_in_number_and_bytes(tmp_path, monkeypatch):
    played = [row(cell, 0, "success") for cell in CELLS if cell.condition == NORMAL]
    save_videos(tmp_path, played)
    assert len(tracked_videos(tmp_path, lambda: played)) == 4
    monkeypatch.setattr(videos, "MOST_VIDEOS", 3)
    assert len(tracked_videos(tmp_path, lambda: played)) == 3
    monkeypatch.setattr(videos, "MOST_BYTES", 25)
    assert len(tracked_videos(tmp_path, lambda: played)) == 2


def test_a_run_without_videos_sends_none(tmp_path):
    assert tracked_videos(tmp_path, lambda: rows("success", 3)) == []
