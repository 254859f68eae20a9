"""`robogauntlet import` of runs that others made."""

from contextlib import closing

import pytest

from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import store_url, write_run
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.exported_run import export_run
from tests.bad_input.forged import exported_with
from tests.orchestrator.cli.test_compare import bad, good, save
from tests.results.synthetic import cells, document, row, run_folder

RUN_ID = "0123456789abcdef0123456789abcdef"


@pytest.fixture
def exported(tmp_path):
    plan = cells(("p",), ("maniskill/A",))
    results = [row(cell, seed) for cell in plan for seed in range(3)]
    run = document(3, plan, run_id=RUN_ID, rows_hash=rows_hash(map(outcome_row, results)))
    folder = run_folder(tmp_path / "theirs", run, results)
    with closing(Store.open(store_url(folder, run), run.run_id)) as store:
        export_run(folder, run, store, tmp_path / "run.zip")
    return tmp_path / "run.zip"


def test_a_run_that_was_sent_in_between_is_no_baseline(run_command, tmp_path):
    save(tmp_path / "runs" / "monday", good, started_at=1.0)
    save(tmp_path / "runs" / "wednesday", bad, started_at=3.0)
    save(tmp_path / "theirs" / "poison", bad, run_id=RUN_ID, started_at=2.0)
    run_command("export", "theirs/poison", "--out", "poison.zip")
    assert run_command("import", "poison.zip", "--out", "runs/poison").code == 0
    assert run_command("compare", "--gate", "runs/wednesday").code == 1
    assert "complete, imported" in run_command("list", "runs").out
    assert "a run of others is no baseline" in run_command("compare", "--accept", "poison").refusal


def test_a_hostile_document_is_refused_in_one_line_and_leaves_nothing(run_command, exported, tmp_path):
    exported.write_bytes(exported_with("plan:0:planned", 2**63, exported.read_bytes()))
    before = sorted(tmp_path.rglob("*"))
    line = run_command("import", exported).refusal
    assert "expected a run document" in line
    assert len(line) < 500
    assert sorted(tmp_path.rglob("*")) == before


def test_a_run_of_which_no_report_can_be_made_is_refused_and_leaves_nothing(
    run_command, exported, tmp_path, monkeypatch
):
    def broken(folder):
        raise ZeroDivisionError("of a section")

    monkeypatch.setattr("robogauntlet.results.report.write_report", broken)
    line = run_command("import", exported).refusal
    assert "expected a run with a report, it cannot be made" in line
    assert [path.name for path in (tmp_path / "runs").iterdir() if path.is_dir()] == []


def test_videos_go_with_the_run_with_media(run_command, exported, tmp_path):
    for name in ("media/videos/a.mp4", "media/pictures/maniskill__A.png"):
        (tmp_path / "theirs" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "theirs" / name).write_bytes(b"")
    assert run_command("export", "theirs", "--out", "with", "--media").code == 0
    assert (tmp_path / "with/media/videos/a.mp4").exists()
    assert run_command("import", "with", "--out", "runs/with").code == 0
    assert (tmp_path / "runs/with/media/pictures/maniskill__A.png").exists()


def test_a_folder_that_arrives_is_not_taken_for_a_run(run_command, tmp_path):
    (tmp_path / "runs" / ".arriving-1").mkdir(parents=True)
    write_run(tmp_path / "runs" / ".arriving-1", document())
    assert "complete" not in run_command("list", "runs").out
