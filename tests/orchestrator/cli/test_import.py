"""`robogauntlet import` of runs that others made."""

import json
import sqlite3
from contextlib import closing

import pytest

from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import store_url, write_run
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.run_archive import export_run
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
        export_run(run, store, tmp_path / "run.robogauntlet")
    return tmp_path / "run.robogauntlet"


def forge(file, change):
    with closing(sqlite3.connect(file)) as connection, connection:
        content = json.loads(connection.execute("SELECT document FROM runs").fetchone()[0])
        change(content)
        connection.execute("UPDATE runs SET document = ?", [json.dumps(content)])


def test_a_run_that_was_sent_in_between_is_no_baseline(run_command, tmp_path):
    save(tmp_path / "runs" / "monday", good, started_at=1.0)
    save(tmp_path / "runs" / "wednesday", bad, started_at=3.0)
    save(tmp_path / "theirs" / "poison", bad, run_id=RUN_ID, started_at=2.0)
    run_command("export", "theirs/poison", "--out", "poison.robogauntlet")
    assert run_command("import", "poison.robogauntlet", "--out", "runs/poison").code == 0
    assert run_command("gate", "runs/wednesday").code == 1
    assert "complete, imported" in run_command("history").out
    assert "a run of others is never a baseline" in run_command("accept", "poison").refusal


HOSTILE = {
    "planned beyond 64 bits": lambda content: content["plan"][0].update(planned=2**63),
    "a time beyond all years": lambda content: content.update(started_at=1e20),
    "text for a time": lambda content: content.update(started_at="yesterday"),
    "text for the plan": lambda content: content.update(plan="all"),
    "a suite of numbers": lambda content: content.update(suite=[1, 2, 3]),
    "not a number": lambda content: content.update(elapsed_s=float("nan")),
    "a long name": lambda content: content["plan"][0].update(policy="x" * 3_000_000),
}


@pytest.mark.parametrize("change", HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_document_is_refused_in_one_line_and_leaves_nothing(run_command, exported, tmp_path, change):
    forge(exported, change)
    before = sorted(tmp_path.rglob("*"))
    line = run_command("import", exported).refusal
    assert "expected a run document" in line
    assert len(line) < 500
    assert sorted(tmp_path.rglob("*")) == before


def test_a_run_whose_comparison_names_nobody_is_refused(run_command, exported, tmp_path):
    roles = {"expert": "a", "oracle_routed": "b", "routed": ["c"]}
    forge(exported, lambda content: content["suite"].update(merging=roles))
    before = sorted(tmp_path.rglob("*"))
    assert "its suite compares policy 'a', which it does not play" in run_command("import", exported).refusal
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"environments": {"null": {"interpreter": "/tmp/their-python"}}}, "its suite names a program"),
        ({"description": "x" * 3_000_000}, "suite.description"),
    ],
    ids=["program", "description"],
)
def test_a_suite_that_nobody_may_write_is_refused(run_command, exported, change, words):
    forge(exported, lambda content: content["suite"].update(change))
    assert words in run_command("import", exported).refusal


@pytest.mark.parametrize("field", ["policy", "task", "axis", "simulator"])
def test_names_with_control_characters_are_refused(run_command, exported, field):
    forge(exported, lambda content: content["plan"][0].update({field: "a\x1b[31m\u202eb"}))
    assert "a name in its plan has control characters" in run_command("import", exported).refusal


def test_a_folder_that_arrives_is_not_taken_for_a_run(run_command, tmp_path):
    (tmp_path / "runs" / ".arriving-1").mkdir(parents=True)
    write_run(tmp_path / "runs" / ".arriving-1", document())
    assert "complete" not in run_command("history").out
