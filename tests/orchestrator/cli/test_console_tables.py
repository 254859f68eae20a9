"""The tables that a run prints at its end."""

import pytest

from robogauntlet.orchestrator.cli import console_tables
from robogauntlet.results.report import write_report
from robogauntlet.suites.episode import Condition
from tests.results.routed import routed_document, routed_rows
from tests.results.synthetic import cells, document, row, rows, run_folder


@pytest.fixture
def print_lines(tmp_path, capsys, monkeypatch):
    """What is printed about a run, a list of words per line."""
    monkeypatch.setattr(console_tables.out, "_width", 200)

    def summarise(**changes):
        folder = run_folder(tmp_path / "run", routed_document(10, **changes), routed_rows(10))
        console_tables.print_summary(write_report(folder))
        return [line.split() for line in capsys.readouterr().out.splitlines()]

    return summarise


def test_a_suite_that_compares_merged_policies_gets_their_table(print_lines):
    lines = print_lines()
    heads = [line for line in lines if line[:3] == ["task", "expert", "oracle-routed"]]
    assert heads == [["task", "expert", "oracle-routed", "routed", "accuracy", "n"]] * 2
    assert [line[-1] for line in lines if line[:1] == ["all"]] == ["50", "50"]
    assert ["percentage", "points", "merged", "merged-paper"] in lines


def test_the_table_fits_a_terminal_of_80_columns(print_lines, monkeypatch):
    monkeypatch.setattr(console_tables.out, "_width", 80)
    lines = print_lines()
    start = next(i for i, line in enumerate(lines) if line[:3] == ["task", "expert", "oracle-routed"])
    assert not any("…" in word for line in lines[start:] for word in line)


def test_other_suites_get_no_such_table(print_lines):
    assert not any(line[:3] == ["task", "expert", "oracle-routed"] for line in print_lines(merging=None))


def test_a_suite_of_many_conditions_gets_a_line_for_each_and_the_findings(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(console_tables.out, "_width", 200)
    conditions = (Condition(), *(Condition(axis, level) for axis in ("noise", "blur") for level in (1, 2, 3)))
    plan = cells(("experts", "merged"), conditions=conditions)
    folder = run_folder(tmp_path / "run", document(20, of=plan), rows(plan, 20))
    console_tables.print_summary(write_report(folder))
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines if line.startswith(("clean", "noise@", "blur@"))] == [
        str(condition) for condition in conditions
    ]
    assert len([line for line in lines if line.startswith("robosuite/")]) == 1
    assert any(line.startswith("- experts: ") for line in lines)


def test_tasks_that_were_left_out_are_counted_by_reason(tmp_path, capsys):
    plan = cells(("expert",))
    played, *missing = plan
    error = "left out: it shows a scene that these assets lack"
    found = [*rows([played], 4), *(row(cell, seed, "error", error=error) for cell in missing for seed in range(4))]
    report = write_report(run_folder(tmp_path / "run", document(4, of=plan), found))
    console_tables.print_summary(report)
    assert f"- 12 episodes {error}" in capsys.readouterr().out.splitlines()
    assert "12 errors, of which 12 left out for missing files" in (tmp_path / "run" / "report.md").read_text()


def test_thousands_of_tasks_are_not_printed_one_by_one(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(console_tables, "MAX_TASKS", 3)
    plan = cells(("expert",))
    console_tables.print_summary(write_report(run_folder(tmp_path / "run", document(4, of=plan), rows(plan, 4))))
    printed = capsys.readouterr().out
    assert plan[0].task not in printed
    assert "Per simulator" in printed
