"""Which videos a tracker receives."""

from robogauntlet.orchestrator.trackers import videos
from robogauntlet.orchestrator.trackers.videos import tracked_videos
from robogauntlet.results.media_paths import video_path
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, row

NORMAL, NOISE = Condition(), Condition("noise", 2)
CELLS = cells(("a", "b"), ("null/Reach", "null/Slow"), (NORMAL, NOISE))


def rows(status, count, policy="a", condition=NORMAL):
    chosen = [cell for cell in CELLS if (cell.policy, cell.condition) == (policy, condition)]
    return [row(chosen[0], seed, status) for seed in range(count)]


def save_videos(folder, recorded, size=10):
    for it in recorded:
        path = video_path(folder, it.episode_id)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(size))


def test_a_success_and_a_failure_of_each_policy_and_task_are_sent_of_those_with_a_video(tmp_path):
    played = [*rows("success", 3), *rows("failure", 2, policy="b"), *rows("error", 1, policy="b")]
    save_videos(tmp_path, [played[1], *played[4:]])
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
