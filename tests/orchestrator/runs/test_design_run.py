"""A run of a design: rows, report and the video of a cluster."""

import pytest

from robogauntlet.orchestrator.replay.media_selection import shared_by
from robogauntlet.results.api import open_run
from robogauntlet.results.record import Status
from tests.orchestrator.runs.playing import play, rows_of

pytestmark = [pytest.mark.ray, pytest.mark.usefixtures("ray_here")]
SUITE = """
name: pushed
policies: [oracle]
tasks: [null/Reach]
horizon: 18
design: {kind: latin-hypercube, axes: [action-delay, action-noise], points: 120}
seeds: {count: 4}
workers: 1
"""


@pytest.fixture(scope="module")
def played(tmp_path_factory, ray_here):
    folder = tmp_path_factory.mktemp("runs")
    (folder / "s.yaml").write_text(SUITE)
    return play(folder / "s.yaml", folder / "run", media=True)


def test_every_point_is_played_at_every_seed_without_error(played):
    rows = rows_of(played.folder)
    assert {row.error for row in rows} == {None}
    assert len(rows) == 121 * 4
    assert all("action-delay" in row.delivered_statistics for row in rows if "action-delay@" in row.axis)


def test_the_report_says_when_the_policy_fails_with_a_video_of_it(played):
    page = (played.folder / "report.html").read_text()
    assert page.index("Why it fails") < page.index("Success rates")
    assert "where action-delay is " in page
    rows = rows_of(played.folder)
    videos = {path.stem for path in (played.folder / "media/videos").glob("*.mp4")}
    shown = {shared_by(row) for row in rows if row.episode_id in videos}
    assert any(shared_by(row) in shown and row.status == Status.FAILURE and "@" in row.axis for row in rows)
    assert 'class="failure"' in page[page.index("Failure clusters") : page.index('id="rates"')]


def test_the_run_is_opened_from_python(played):
    run = open_run(played.folder)
    assert len(run.tables().conditions) == 121
