"""Tests of results/store/run_history.py and results/store/history_import.py: many runs in one store."""

import json
import shutil
from contextlib import closing

import pytest

from robogauntlet.results.live_status import LiveSimulator, LiveStatus
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import RunError, RunStatus, write_run
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.history_import import record_run_folder, record_run_folders
from robogauntlet.results.store.history_records import Counts, rows_url
from robogauntlet.results.store.run_history import HISTORY_FILE, History
from tests.results.synthetic import cells, document, execute, row, rows, run_folder


@pytest.fixture
def history(tmp_path):
    with closing(History.open(file_url(tmp_path / HISTORY_FILE))) as opened:
        yield opened


def night(number, **changes):
    return document(4, run_id=f"run-{number}", started_at=1_760_000_000.0 + 86_400 * number, **changes)


def counted(successes=3, failures=1):
    return {(cell.policy_digest, cell.task, "clean", 0): Counts(0, successes, failures) for cell in cells(("oracle",))}


def test_a_run_is_found_by_its_id_its_beginning_or_its_folder(history, tmp_path):
    history.record(night(1), tmp_path / "first")
    history.record(night(2), tmp_path / "second")
    assert history.find("run-2").name == "second"
    assert history.find("first").run_id == "run-1"
    assert history.find("run-") is None  # too short to name one
    assert history.find("%") is None
    assert history.find("") is None


def test_recording_again_replaces_the_entry(history):
    history.record(night(1, status=RunStatus.RUNNING))
    history.record(night(1), counted=counted())
    (entry,) = history.runs()
    assert (entry.status, entry.counts.done) == ("complete", 16)
    assert entry.counts.planned == night(1).planned


def test_recording_a_restart_keeps_the_counts(history):
    history.record(night(1), counted=counted())
    history.record(night(1, status=RunStatus.RUNNING))
    assert history.find("run-1").counts.done == 16


def test_runs_are_listed_newest_first_by_suite_and_status(history):
    for number in range(5):
        history.record(night(number, name="a" if number % 2 else "b"))
    assert [entry.run_id for entry in history.runs(limit=2)] == ["run-4", "run-3"]
    assert [entry.run_id for entry in history.runs(suite="a")] == ["run-3", "run-1"]
    assert history.runs(status="running") == []
    assert history.suites() == {"a": 2, "b": 3}


def test_a_policy_is_followed_from_run_to_run_the_oldest_first(history):
    for number, won in enumerate((4, 3, 1)):
        history.record(night(number), counted=counted(won, 4 - won))
    assert [one.counts.rate for one in history.policy_history("oracle")] == [1.0, 0.75, 0.25]
    assert [one.counts.verdicts for one in history.policy_history("oracle", task=cells()[0].task)] == [4, 4, 4]
    assert [one.run.run_id for one in history.policy_history("oracle", limit=2)] == ["run-1", "run-2"]
    assert history.policy_history("unknown") == []


def test_the_baseline_is_the_last_good_run_of_the_suite_before_it(history):
    for number, status in enumerate((RunStatus.COMPLETE, RunStatus.COMPLETE, RunStatus.STOPPED)):
        history.record(night(number, status=status))
    history.record(night(3, name="another"))
    tonight = night(4)
    history.record(tonight)
    assert history.baseline(tonight).run_id == "run-1"
    history.write_verdict("run-1", "regressed", "run-0", ["worse"])
    assert history.baseline(tonight).run_id == "run-0"
    history.accept("run-1")
    assert history.baseline(tonight).run_id == "run-1"
    assert history.baseline(night(0)) is None


def test_a_run_that_counts_success_otherwise_is_no_baseline(history):
    for number, rule in enumerate(("held", "once", "held")):
        history.record(night(number, success=rule))
    found = {rule: history.baseline(night(4, success=rule)) for rule in ("held", "once")}
    assert {rule: one.run_id for rule, one in found.items()} == {"held": "run-2", "once": "run-1"}


def test_the_live_status_of_a_run_is_there_until_it_ends(history):
    history.record(night(1, status=RunStatus.RUNNING))
    lane = LiveSimulator(simulator="null", planned=9, successes=1, failures=1, errors=1)
    history.write_live_status("run-1", LiveStatus(at=5.0, phase="playing", simulators=(lane,)))
    assert history.find("run-1").live.simulators[0].done == 3
    history.record(night(1))
    assert history.find("run-1").live is None


def test_a_live_status_of_another_version_is_ignored(history):
    history.record(night(1, status=RunStatus.RUNNING))
    with history.database.writing() as connection:
        connection.exec_driver_sql("UPDATE runs SET live = '{}'")
    assert history.find("run-1").live is None


def test_the_document_comes_back_as_it_was(history):
    history.record(night(1))
    assert history.document("run-1") == night(1)


def test_runs_made_elsewhere_are_recorded_once(history, tmp_path):
    results = rows(planned=4, errors=1)
    run_folder(tmp_path / "one", night(1), results)
    run_folder(tmp_path / "two", night(2, status=RunStatus.INTERRUPTED), results[:5])
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "run.json").write_text("{")
    assert record_run_folders(history, tmp_path) == 2
    assert record_run_folders(history, tmp_path) == 0
    assert history.find("one").counts.done == len(results)
    assert history.find("two").counts.done == 5
    assert history.find("one").counts.errors == 8


def test_a_run_that_ended_without_the_history_is_recorded(history, tmp_path):
    history.record(night(1, status=RunStatus.RUNNING), tmp_path / "one")
    run_folder(tmp_path / "one", night(1), rows(planned=4))
    assert record_run_folders(history, tmp_path) == 1
    assert history.find("one").status == "complete"


def test_the_url_of_the_rows_is_that_of_the_entry(history, tmp_path):
    folder = run_folder(tmp_path / "one", night(1), [])
    history.record(night(1), folder)
    assert rows_url(history.find("one"), history.url) == file_url(folder / "episodes.sqlite")
    (folder / "episodes.sqlite").unlink()
    with pytest.raises(RunError, match="they are gone"):
        rows_url(history.find("one"), history.url)
    url = "postgresql+psycopg://me:***@far/db"
    history.record(night(2, store_url=url), tmp_path / "two")
    with pytest.raises(RunError, match="give that address with --store"):
        rows_url(history.find("run-2"), history.url)
    assert rows_url(history.find("run-2"), url.replace("***", "secret")).startswith("postgresql")


def test_rows_and_runs_may_share_a_store(history):
    history.record(night(1))
    store = Store(history.database, "run-1")
    store.add([row(cells()[0], 0), row(cells()[0], 1, "failure"), row(cells()[0], 2, "error")])
    assert list(history.count_cells("run-1").values()) == [Counts(0, 1, 1, 1)]


def test_a_broken_run_costs_no_other_run(history, tmp_path):
    run_folder(tmp_path / "a", night(1), rows(planned=4))
    run_folder(tmp_path / "z", night(2), rows(planned=4))
    for name, change in {"huge": {"planned": 2**63}, "early": {"started_at": 1e20}, "odd": {"run_id": "\x00"}}.items():
        content = json.loads(night(3).model_dump_json())
        content["plan"][0] |= {"planned": change.pop("planned", 1)}
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text(json.dumps(content | change))
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "run.json").write_bytes(b"\xff")
    named = []
    assert record_run_folders(history, tmp_path, named.append) >= 2
    assert {entry.name for entry in history.runs()} >= {"a", "z"}
    assert {line.split()[0] for line in named} >= {"huge", "early", "m"}
    assert all(" is passed over: " in line and "\n" not in line for line in named)


def test_hidden_folders_are_no_runs(history, tmp_path):
    run_folder(tmp_path / ".arriving-1", night(1), [])
    assert record_run_folders(history, tmp_path) == 0


def test_an_imported_run_is_never_a_baseline(history):
    history.record(night(1))
    history.record(night(2, origin="imported"))
    history.accept("run-2")
    assert history.baseline(night(3)).run_id == "run-1"
    assert not history.find("run-2").is_baseline_material


def test_a_run_that_was_accepted_is_so_for_its_rows(history):
    history.record(night(1, rows_hash="a" * 16))
    history.accept("run-1")
    history.record(night(1, rows_hash="a" * 16, reason="the same rows"))
    assert history.find("run-1").accepted
    history.record(night(1, rows_hash="b" * 16))
    assert not history.find("run-1").accepted


def test_a_folder_that_was_played_elsewhere_is_recorded_as_the_word_of_others(history, tmp_path):
    run_folder(tmp_path / "mine", night(1), [])
    run_folder(tmp_path / "theirs", night(2), [], own=False)
    assert record_run_folders(history, tmp_path) == 2
    assert {entry.name: entry.imported for entry in history.runs()} == {"mine": False, "theirs": True}
    assert history.baseline(night(3)).run_id == "run-1"


def test_a_copy_of_a_run_is_named_and_changes_nothing(history, tmp_path):
    run_folder(tmp_path / "monday", night(1), rows(planned=4))
    assert record_run_folders(history, tmp_path) == 1
    shutil.copytree(tmp_path / "monday", tmp_path / "a-copy")
    for _ in range(2):
        named = []
        assert record_run_folders(history, tmp_path, named.append) == 0
        assert named == [f"a-copy is passed over: a copy of {tmp_path / 'monday'}"]
        assert [entry.name for entry in history.runs()] == ["monday"]


def test_a_run_whose_folder_was_renamed_is_found_there(history, tmp_path):
    run_folder(tmp_path / "monday", night(1), [])
    record_run_folders(history, tmp_path)
    (tmp_path / "monday").rename(tmp_path / "tuesday")
    record_run_folders(history, tmp_path)
    assert [(entry.name, entry.imported) for entry in history.runs()] == [("tuesday", False)]


def altered(folder):
    """The same run, as its sender would have it end."""
    execute(folder / "episodes.sqlite", "UPDATE episodes SET status = 'failure'")
    return folder


@pytest.mark.parametrize("change", [altered, lambda folder: write_run(folder, night(1, rows_hash="b" * 16))])
def test_a_folder_that_only_says_that_it_is_an_accepted_run_does_not_become_the_baseline(history, tmp_path, change):
    results = list(rows(planned=4))
    run = night(1, rows_hash=rows_hash(map(outcome_row, results)))
    folder = run_folder(tmp_path / "monday", run, results)
    record_run_folders(history, tmp_path)
    history.accept("run-1")
    shutil.copytree(folder, tmp_path / "theirs")
    shutil.rmtree(folder)
    change(tmp_path / "theirs")
    named = []
    assert record_run_folders(history, tmp_path, named.append) == 0
    assert "theirs is passed over: it says that it is run run-1, which the history has" in named[0]
    assert history.baseline(night(3)).folder == str(folder)


def test_a_run_of_others_that_starts_in_the_future_is_passed_over(history, tmp_path):
    run_folder(tmp_path / "theirs", night(61_000), [], own=False)
    named = []
    assert record_run_folders(history, tmp_path, named.append) == 0
    assert "expected a start in the past, got 2192-" in named[0]


def test_a_history_says_which_runs_were_imported(history):
    history.record(night(1))
    history.record(night(2, origin="imported"))
    assert [entry.status_text for entry in history.runs()] == ["complete, imported", "complete"]


def test_a_forgotten_run_is_recorded_again_only_by_name(history, tmp_path):
    folder = run_folder(tmp_path / "one", night(1), rows(planned=4))
    record_run_folders(history, tmp_path)
    history.forget("run-1", str(folder))
    assert history.runs() == []
    assert record_run_folders(history, tmp_path) == 0
    record_run_folder(history, folder, night(1))
    assert [entry.name for entry in history.runs()] == ["one"]


def test_a_history_of_before_gets_the_tables_that_it_lacks(tmp_path):
    path = tmp_path / HISTORY_FILE
    with closing(History.open(file_url(path))) as history:
        history.record(night(1))
    execute(path, "DROP TABLE imported_runs", "DROP TABLE forgotten_runs")
    with closing(History.open(file_url(path))) as history:
        assert [entry.imported for entry in history.runs()] == [False]
