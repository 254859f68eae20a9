"""Videos and snapshots of a run: after its numbers, in a share of its time, and continued."""

import pytest

from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.replay.media import episodes_to_film, job_of_workers
from robogauntlet.results.record import outcome_row
from robogauntlet.results.run_document import RunStatus, read_run
from robogauntlet.suites.episode import Cell, Protocol
from tests.orchestrator.runs.playing import observer

pytestmark = [pytest.mark.ray, pytest.mark.usefixtures("ray_here")]
CELL, SOURCES = Cell("oracle", "d", "null/Reach", Protocol(60)), {"oracle": PolicySource("oracle", {})}


def test_a_success_and_a_failure_have_one_video_each_that_was_filmed_while_they_were_played(run, suite):
    outcome = run(suite(), media=True)
    rows = {row.episode_id: (row.policy, row.status, row.seed) for row in run.rows()}
    assert sorted(rows[video] for video in videos_of(run)) == [("oracle", "success", 1), ("random", "failure", 1)]
    assert (run.folder / "media/pictures/null__Reach.png").exists()
    assert outcome.warnings == []


def test_missing_videos_of_a_complete_run_are_recorded_once(finished, suite):
    run, path = finished, suite()
    assert not (run.folder / "media").exists()
    assert run(path, media=True).warnings == []
    videos = videos_of(run)
    assert len(videos) == 2
    run(path, media=True)
    assert videos_of(run) == videos


def videos_of(run):
    """Ids of the episodes with a video, and when it was written."""
    return {path.stem: path.stat().st_mtime_ns for path in (run.folder / "media/videos").glob("*.mp4")}


def test_the_first_report_has_what_was_filmed_while_it_was_played_which_changes_no_row(run, suite, finished_folder):
    pages, counts = [], []

    def on_numbers(outcome):
        assert read_run(run.folder).status is RunStatus.COMPLETE
        assert outcome.report.tables.total.done == 40
        pages.append((run.folder / "report.html").read_text())
        counts.append(len(videos_of(run)))

    outcome = run(suite(), media=None, observers=[observer(on_numbers=on_numbers)])
    assert counts == [2]  # the second episode of each policy, since the first row waits for no video
    assert pages[0].count("data:video/mp4") == 2
    assert outcome.document.rows_hash == read_run(finished_folder).rows_hash
    assert {path.suffix for path in (run.folder / "media/videos").iterdir()} == {".mp4"}


def test_the_report_is_written_before_further_videos_and_again_after_them(finished, suite):
    run, path, pages = finished, suite(), []
    pages.append((run.folder / "report.html").read_text())
    outcome = run(path, media=True)
    assert "data:video/mp4" not in pages[0]
    assert (run.folder / "report.html").read_text().count("data:video/mp4") == 2
    assert 0 < outcome.document.media_s < 60


def test_an_episode_whose_video_fails_is_played_all_the_same(tmp_path, monkeypatch):
    def broken(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("robogauntlet.orchestrator.episodes.video_recorder.video_writer", broken)
    lease, runner = Lease(CELL, (0, 1)), EpisodeRunner(SOURCES)
    filmed = episodes_to_film([(CELL, lease.seeds)])
    rows = [*job_of_workers(tmp_path, filmed)(runner, lease)]
    assert [row.status for row in rows] == ["success", "success"]
    assert list(map(outcome_row, rows)) == list(map(outcome_row, job_of_workers(tmp_path, ())(runner, lease)))
    assert not list(tmp_path.rglob("*.mp4"))


@pytest.mark.parametrize("attempt", [1, 2])
def test_an_episode_is_filmed_at_its_first_attempt_only_as_drawing_may_have_ended_its_worker(tmp_path, attempt):
    job = job_of_workers(tmp_path, episodes_to_film([(CELL, (0,))]))
    (row,) = job(EpisodeRunner(SOURCES), Lease(CELL, (0,), attempt))
    assert [path.stem for path in tmp_path.rglob("*.mp4")] == ([row.episode_id] if attempt == 1 else [])


def test_videos_take_a_share_of_the_playing_time_and_those_left_out_are_counted(finished, suite, monkeypatch):
    run, path = finished, suite()
    command = "robogauntlet run nulls --out here"
    monkeypatch.setattr("robogauntlet.orchestrator.runs.run.MEDIA_SHARE", 0.0)
    document = run(path, media=None, command=command).document
    (video,) = videos_of(run)  # a failure comes first, however little time there is
    assert [row.status for row in run.rows() if row.episode_id == video] == ["failure"]
    assert document.media_left_out == 1
    page = (run.folder / "report.html").read_text()
    assert "Not recorded: 1" in page
    assert f"<code>{command} --media</code>" in page
    monkeypatch.setattr("robogauntlet.orchestrator.runs.run.MEDIA_SHARE", 100.0)
    document = run(path, media=None).document
    assert (document.media_left_out, len(videos_of(run))) == (0, 2)
    assert "Not recorded" not in (run.folder / "report.html").read_text()
    assert "for at most" in run.output.getvalue()


def test_no_simulator_is_started_for_videos_that_cannot_start_it_in_their_time(run, suite, monkeypatch):
    monkeypatch.setattr("robogauntlet.orchestrator.runs.run.MEDIA_SHARE", 0.01)
    monkeypatch.setattr("robogauntlet.orchestrator.runs.run.FIRST_FAILURES_S", 0.0)
    monkeypatch.setattr("robogauntlet.orchestrator.replay.media.job_of_workers", lambda *_: EpisodeRunner.play)
    outcome = run(suite(), media=None)
    assert outcome.document.media_left_out == 2
    assert "recording" not in run.output.getvalue()


def test_an_interruption_during_videos_loses_nothing_and_the_next_run_continues(finished, suite):
    run, path = finished, suite()

    def interrupt(run):
        if run.recording is not None and run.recording.done:
            raise KeyboardInterrupt

    outcome = run(path, media=True, observers=[observer(on_tick=interrupt)])
    assert outcome.media_interrupted
    assert (outcome.document.status, outcome.document.media_left_out) == (RunStatus.COMPLETE, 1)
    (recorded,) = videos_of(run)
    assert read_run(run.folder) == outcome.document
    assert (run.folder / "report.html").read_text().count("data:video/mp4") == 1
    outcome = run(path, media=True)
    assert (outcome.media_interrupted, outcome.document.media_left_out) == (False, 0)
    assert videos_of(run).keys() > {recorded}
