"""Names that others chose, on the terminal, in pages and in spreadsheets."""

import csv
import io

import pytest
from typer.testing import CliRunner

from robogauntlet.orchestrator.cli import app
from robogauntlet.results.report import write_report
from robogauntlet.results.report.formatting import spreadsheet_cell
from robogauntlet.results.report.history_tables import when
from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import History
from robogauntlet.support.text import visible
from tests.results.synthetic import cells, document, rows, run_folder

NAME = "a[/]b[red]\x1b[31m\u202ec"
SHOWN = r"a[/]b[red]\x1b[31m\u202ec"
TYPED = "a[/]b[red]"
"""A name that can be given on the command line."""
FORMULA = "=cmd|' /C calc'!A0"
PLAN = cells((NAME, FORMULA))


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    """Two runs of a suite and of policies with such names, and their history."""
    root = tmp_path_factory.mktemp("runs")
    with_rows = rows(PLAN)
    folders = []
    history = History.open(file_url(root / "history.sqlite"))
    for number, suite in ((1, NAME), (2, TYPED)):
        run = document(of=PLAN, run_id=f"run-{number}")
        folders.append(run_folder(root / f"run-{number}", run, with_rows))
        named = document(of=PLAN, run_id=f"run-{number}", name=suite)
        record_run_folder(history, folders[-1], named)
    history.close()
    return folders, file_url(root / "history.sqlite")


def printed(*arguments, code=0):
    done = CliRunner().invoke(app, list(map(str, arguments)), env={"COLUMNS": "200"})
    assert done.exit_code == code, done.output
    assert "\x1b" not in done.output
    assert "\u202e" not in done.output
    return done.output


def test_the_terminal_shows_names_without_carrying_them_out(hostile):
    (one, other), url = hostile
    assert SHOWN in printed("list", "runs", "--history", url)
    assert SHOWN in printed("list", "runs", FORMULA, "--history", url)
    assert "is left out" in printed("compare", "--all", TYPED, "--history", url, code=1)  # no suite has such a name
    assert SHOWN in printed("report", one)
    assert SHOWN in printed("compare", one, other)
    assert SHOWN in printed("compare", one)


def test_reports_show_marks_of_direction_and_carry_nothing_out(hostile):
    folder = hostile[0][0]
    write_report(folder)
    for name in ("report.html", "report.md"):
        text = (folder / name).read_text()
        assert "\\u202e" in text
        assert not {"\x1b", "\u202e"} & set(text)


def test_a_spreadsheet_computes_nothing_of_a_name(hostile):
    folder = hostile[0][0]
    write_report(folder)
    table = folder.parent / "rows.csv"
    printed("export", folder, "--format", "csv", "--out", table)
    for file in (folder / "cells.csv", table):
        assert {line["policy"] for line in csv.DictReader(file.open())} == {NAME, f"'{FORMULA}"}
    text = printed("report", folder, "--table", "csv")
    assert f"'{FORMULA} rate" in next(csv.reader(io.StringIO(text)))


def test_negative_numbers_stay_numbers():
    assert [spreadsheet_cell(value) for value in (-1, -0.5, None, "-1", "a-b", "")] == [
        -1,
        -0.5,
        None,
        "'-1",
        "a-b",
        "",
    ]


@pytest.mark.parametrize("separator", [";", "|", "\t"])
def test_a_spreadsheet_with_another_separator_computes_nothing_either(separator):
    for text in ("x;=1+1", 'x;"=1+1"', "x; @SUM(A1)", "a;b|\t-1", "=1;=1", "x;\n=1"):
        for cell in csv.reader(io.StringIO(spreadsheet_cell(text)), delimiter=separator):
            assert not any(one.strip().startswith(("=", "+", "-", "@")) for one in cell)
    assert spreadsheet_cell("one; two, a-b; 3 = 3") == "one; two, a-b; 3 = 3"


@pytest.mark.parametrize("seconds", [1e20, -1e20, float("nan"), float("inf"), 2.0**63])
def test_a_time_that_no_calendar_has_is_shown_as_none(seconds):
    assert when(seconds) == "–"


def test_text_of_any_script_stays_as_it_is():
    assert visible("Würfel 立方体 שלום – 3 µm") == "Würfel 立方体 שלום – 3 µm"
    assert visible("a\nb\x00\udc80\u2066") == r"a\nb\x00\udc80\u2066"
