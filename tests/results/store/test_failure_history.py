"""Kinds of failures of a policy from run to run."""

import shutil

import pytest

from robogauntlet.results.record import FailureKind
from robogauntlet.results.report.history_plot import kind_history_table, new_kinds
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.failure_history import MOST_RUNS, kinds_by_run, kinds_in_run
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import History
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, row, run_folder

PLAN = cells(("p",), ("maniskill/A", "pybullet/B"), (Condition(), Condition("noise", 2)))
DROPPED, UNSAFE = FailureKind.DROPPED, FailureKind.UNSAFE
NIGHTS = {"monday": None, "tuesday": ["dropped"], "wednesday": ["dropped", "unsafe", "melted"], "thursday": ["dropped"]}
"""Kinds of the first failures of each clean cell; an earlier version played on Monday."""


@pytest.fixture
def history(tmp_path):
    found = History.open(file_url(tmp_path / "history.sqlite"))
    for number, (name, kinds) in enumerate(NIGHTS.items()):
        results = [
            row(cell, seed, "failure", failure=kind if cell.condition == Condition() else "misplaced")
            for cell in PLAN
            for seed, kind in enumerate([*(kinds or []), None])
        ]
        run = document(4, PLAN, run_id=f"run-{number}", started_at=1000.0 * number)
        record_run_folder(found, run_folder(tmp_path / name, run, results), run)
    yield found
    found.close()


def runs_of(history, task=None):
    results = history.policy_history("p", task=task)
    return kinds_by_run(results, lambda result: kinds_in_run(result, history.url, task))


def test_known_kinds_of_clean_episodes_are_counted_for_each_run_that_has_them(history):
    assert [(one.result.run.name, one.kinds) for one in runs_of(history)] == [
        ("tuesday", {DROPPED: 2}),
        ("wednesday", {UNSAFE: 2, DROPPED: 2}),
        ("thursday", {DROPPED: 2}),
    ]
    assert [one.kinds[DROPPED] for one in runs_of(history, "maniskill/A")] == [1, 1, 1]


def test_a_kind_is_new_where_no_earlier_run_had_it(history):
    found = runs_of(history)
    assert [one.new for one in found] == [(), (UNSAFE,), ()]
    assert new_kinds(found) == ["first seen in wednesday: unsafe, 2 of 8 failures"]
    table = kind_history_table(found)
    assert table.header == ("started (UTC)", "run", "failures", "unsafe", "dropped")
    assert [row[1:] for row in table.rows] == [
        ("tuesday", "4", "–", "2"),
        ("wednesday", "8", "2", "2"),
        ("thursday", "4", "–", "2"),
    ]


def test_runs_whose_rows_are_gone_are_left_out(history, tmp_path):
    shutil.rmtree(tmp_path / "tuesday")
    assert [one.result.run.name for one in runs_of(history)] == ["wednesday", "thursday"]


def test_only_the_rows_of_the_newest_runs_are_read(history):
    (newest,) = history.policy_history("p")[-1:]
    read = []
    kinds_by_run([newest] * (MOST_RUNS + 5), lambda result: read.append(result) or {})
    assert len(read) == MOST_RUNS
