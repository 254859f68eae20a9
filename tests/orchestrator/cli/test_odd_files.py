"""A path that is no regular file ends nothing: it is refused at once, and other runs are there."""

import os

import pytest

from tests.bad_input.test_verbs import deadline
from tests.orchestrator.cli.test_compare import bad, good, save

DEADLINE_S = 20


@pytest.fixture(params=["pipe", "device"])
def make_odd(request):
    """Makes a path that never ends when it is read."""
    return os.mkfifo if request.param == "pipe" else lambda path: path.symlink_to("/dev/zero")


@pytest.fixture
def runs(tmp_path, make_odd):
    """Two good runs, and one whose document is odd."""
    root = tmp_path / "runs"
    save(root / "monday", good, run_id="1" * 32, started_at=1.0)
    save(root / "tuesday", bad, run_id="2" * 32, started_at=86_400.0)
    (root / "theirs").mkdir()
    make_odd(root / "theirs" / "run.json")
    return root


@pytest.mark.usefixtures("runs")
def test_a_list_of_runs_passes_it_over(run_command):
    for typed in ("list runs", "compare --all synthetic", "compare --gate runs/tuesday"):
        with deadline(DEADLINE_S):
            done = run_command(*typed.split())
        assert done.code == (typed.startswith("compare --gate")), done.err
        assert "tuesday" in done.out
        assert "theirs" in done.err or typed.startswith("compare --gate")


@pytest.mark.usefixtures("runs")
@pytest.mark.parametrize(
    "typed",
    [
        *(
            "report runs/theirs",
            "replay --verify runs/theirs",
            "export runs/theirs --out new",
            "compare runs/monday runs/theirs",
        ),
        "compare --gate runs/monday runs/theirs",
    ],
)
def test_a_run_document_is_refused(run_command, typed):
    with deadline(DEADLINE_S):
        refusal = run_command(*typed.split()).refusal
    assert refusal.startswith("runs/theirs/run.json: expected a run document, got a ")


def test_a_store_and_what_is_beside_it_is_refused(run_command, runs, make_odd):
    make_odd(runs / "monday" / "episodes.sqlite-journal")
    (runs / "tuesday" / "episodes.sqlite").unlink()
    make_odd(runs / "tuesday" / "episodes.sqlite")
    with deadline(DEADLINE_S):
        assert "episodes.sqlite-journal beside it is no file" in run_command("report", "runs/monday").refusal
        assert "this is no file" in run_command("report", "runs/tuesday").refusal


def test_an_exported_run_and_a_suite_are_refused(run_command, tmp_path, make_odd):
    make_odd(tmp_path / "odd")
    with deadline(DEADLINE_S):
        assert "no regular file" in run_command("import", "odd").refusal
        assert run_command("plan", "--check", "odd").refusal.endswith(", no regular file")


def test_media_of_a_run_are_left_out(run_command, runs, make_odd):
    for folder in ("videos", "snapshots"):
        (runs / "monday" / "media" / folder).mkdir(parents=True)
    make_odd(runs / "monday" / "media" / "videos" / "x.mp4")
    make_odd(runs / "monday" / "media" / "snapshots" / "x.png")
    with deadline(DEADLINE_S):
        assert run_command("report", "runs/monday").code == 0
