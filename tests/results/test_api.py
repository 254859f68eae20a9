"""Runs as notebooks open them."""

import pandas as pd
import pytest

import robogauntlet
from robogauntlet.results.analysis.comparison import Difference, Verdict
from robogauntlet.results.record import FIELDS
from robogauntlet.results.run_document import RunError
from tests.errors import one_line_error
from tests.results.synthetic import cells, document, row, rows_where, run_folder


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


def test_numbers_that_are_missing_are_nan_also_if_all_are(tmp_path):
    results = [row(cells()[0], seed, contact_steps=3 if seed else None) for seed in range(3)]
    folder = run_folder(tmp_path / "run", document(3), results)
    frame = robogauntlet.open_run(folder).episodes(("contact_steps", "path_length", "failure", "seed"))
    assert list(map(str, frame.dtypes)) == ["float64", "float64", "object", "int64"]
    assert frame["contact_steps"].tolist()[1:] == [3.0, 3.0]
    assert frame["path_length"].isna().all()


def test_a_field_that_episodes_do_not_have_is_refused(folders):
    with one_line_error(RunError, "expected fields of an episode, got 'statu'; did you mean 'status'"):
        robogauntlet.open_run(folders[0]).episodes(("task", "statu"))


def test_tables_are_those_of_the_report(folders):
    tables = robogauntlet.open_run(folders[0]).tables()
    assert tables.total.rate == 0.5


def test_a_run_shows_what_it_is(folders):
    assert repr(robogauntlet.open_run(folders[0])).endswith("now: suite synthetic, 120 episodes planned, complete")


def test_success_is_a_table_with_intervals_per_policy_task_and_condition(folders):
    run = robogauntlet.open_run(folders[0])
    table = run.table()
    assert list(table["task"]) == [cell.task for cell in run.document.plan]
    assert table["n"].sum() == 120
    row = table.iloc[0]
    assert (row["success"], row["errors"], row["missing"]) == (0.5, 0, 0)
    assert 0.33 < row["low"] < 0.34
    assert 0.66 < row["high"] < 0.67


def test_a_run_shows_its_table_when_it_is_printed_and_in_notebooks(folders):
    run = robogauntlet.open_run(folders[0])
    assert str(run).splitlines()[0] == repr(run)
    assert len(str(run).splitlines()) == 2 + len(run.table())
    page = run._repr_html_()
    assert "now: suite synthetic, 120 episodes planned, complete</p>" in page
    assert page.count("<td>p</td>") == len(run.table())
    assert "<td>0.50</td>" in page


def test_text_of_a_run_is_escaped_in_notebooks(tmp_path):
    own = cells(("p",))
    folder = run_folder(tmp_path / "<b>", document(1, own), rows_where(lambda cell, seed: True, own, 1))
    assert "<b>" not in robogauntlet.open_run(folder)._repr_html_()


def test_a_comparison_prints_itself(folders):
    found = robogauntlet.compare(*folders)
    assert found.verdict is Verdict.REGRESSED
    assert str(found).startswith("REGRESSED: now against before\n")
    assert found.kind == "runs"
    assert found._repr_markdown_().startswith("### ")
    back = robogauntlet.compare(robogauntlet.open_run(folders[1]), folders[0], allowed={Difference.SUITE})
    assert back.verdict is Verdict.IMPROVED


@pytest.fixture
def two_policies(tmp_path):
    own = cells(("p", "q"))
    rows = rows_where(lambda cell, seed: seed % (5 if cell.policy == "p" else 2), own, 30)
    return run_folder(tmp_path / "both", document(30, own, run_id="both"), rows)


def test_policies_of_a_run_are_compared_and_printed(two_policies):
    found = robogauntlet.open_run(two_policies).compare("p", "q", margin=0.05)
    assert found.comparisons[0].overall.difference.value == pytest.approx(0.3)
    assert found.kind == "policies"
    assert str(found).startswith("p against q: +30.0 [")
    assert found._repr_markdown_().startswith("### p against q: +30.0 [")
    assert str(robogauntlet.open_run(two_policies).compare()).startswith("p against q: +30.0 [")


def test_policies_of_two_runs_are_compared(two_policies, folders):
    found = robogauntlet.open_run(two_policies).compare("q", "p", other=folders[1])
    assert str(found).startswith("both:q against before:p: -30.0 [")


def test_a_comparison_needs_two_policies_that_the_run_has(two_policies):
    run = robogauntlet.open_run(two_policies)
    with pytest.raises(RunError, match="expected two policies to compare, got p"):
        run.compare("p")
    with pytest.raises(RunError, match="both: the run has no policy 'x'; known: p, q"):
        run.compare("p", "x")


def test_opening_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(RunError, match="expected a run folder"):
        robogauntlet.open_run(tmp_path)
