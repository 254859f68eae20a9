"""Runs as notebooks open them."""

import pandas as pd
import pytest

import robogauntlet
from robogauntlet.results.analysis.comparison import Difference, Verdict
from robogauntlet.results.record import FIELDS
from robogauntlet.results.run_document import RunError
from tests.results.synthetic import cells, document, rows_where, run_folder


@pytest.fixture
def folders(tmp_path):
    def save(name, every):
        own = cells(("p",))
        rows = rows_where(lambda cell, seed: seed % every, own, 30)
        return run_folder(tmp_path / name, document(30, own, run_id=name), rows)

    return save("now", 2), save("before", 5)


def test_episodes_are_a_table_with_a_row_each_and_the_fields_of_the_record(folders):
    frame = robogauntlet.open_run(folders[0]).episodes()
    assert isinstance(frame, pd.DataFrame)
    assert tuple(frame.columns) == FIELDS
    assert len(frame) == robogauntlet.open_run(str(folders[0])).document.planned


def test_tables_are_those_of_the_report(folders):
    tables = robogauntlet.open_run(folders[0]).tables()
    assert tables.total.rate == 0.5


def test_a_run_shows_what_it_is(folders):
    assert repr(robogauntlet.open_run(folders[0])).endswith("now: suite synthetic, 120 episodes planned, complete")


def test_a_comparison_prints_itself(folders):
    found = robogauntlet.compare(*folders)
    assert found.verdict is Verdict.REGRESSED
    assert str(found).startswith("REGRESSED: now against before\n")
    assert found._repr_markdown_().startswith("### ")
    back = robogauntlet.compare(robogauntlet.open_run(folders[1]), folders[0], allowed={Difference.SUITE})
    assert back.verdict is Verdict.IMPROVED


def test_opening_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(RunError, match="expected a run folder"):
        robogauntlet.open_run(tmp_path)
