"""Tests of results/report/formatting.py."""

from __future__ import annotations

import re
from itertools import product

import pytest

from robogauntlet.results.report import facts, formatting, write_report
from robogauntlet.results.statistics.rates import Interval, RateBounds
from robogauntlet.suites.episode import Condition, Perturbation
from robogauntlet.suites.schema import CompareEntry
from tests.results.synthetic import TASKS, cells, document, rows, run_folder, tables_of


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        *[(None, "–"), (0, "0 %"), (1, "100 %"), (0.8236, "82 %")],
        *[(0.996, "99.6 %"), (0.004, "0.4 %"), (0.9996, ">99.9 %"), (0.0002, "<0.1 %")],
    ],
)
def test_a_rate_is_never_rounded_onto_certainty(value, shown):
    assert formatting.percent(value) == shown


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        *[(None, "–"), (0, "0 s"), (0.0042, "4.2 ms"), (7.314, "7.31 s")],
        *[(59.999, "1 min 0 s"), (725, "12 min 5 s"), (12_000, "3 h 20 min")],
    ],
)
def test_times_have_a_fitting_unit(value, shown):
    assert formatting.seconds(value) == shown


def test_bounds_that_are_close_get_a_digit_more():
    interval = Interval(0, 1)
    assert formatting.bounds(RateBounds(0.468, 0.472, interval)) == "46.8–47.2 %"
    assert formatting.bounds(RateBounds(0.4, 0.9, interval)) == "40–90 %"
    assert formatting.bounds(None) == "–"


@pytest.mark.parametrize("hostile", ["a|b", "<script>alert(1)</script>", "[click](http://x)", "a\nb", "`x`", "**b**"])
def test_markdown_makes_names_harmless(hostile):
    drawn = formatting.markdown(formatting.TextTable(("name", "n"), ((hostile, "1"),), 1))
    lines = drawn.splitlines()
    assert len(lines) == 3
    assert lines[1] == "| --- | ---: |"
    for dangerous in ("<", "](", " `", "**b"):
        assert dangerous not in lines[2]
    assert lines[2].replace("\\|", "").count("|") == 3


@pytest.mark.parametrize(("rule", "said"), [("held", False), ("once", True)])
def test_a_report_states_the_rule_of_success(rule, said):
    of_run = document(success=rule)
    assert ("success at a single step" in facts.verdict(of_run, tables_of(of_run, rows()))) == said
    assert dict(facts.provenance(of_run))["success"].startswith(f"{rule}: ")


def test_the_summary_has_a_row_per_policy_and_a_column_per_simulator():
    table = formatting.summary_table(tables_of(document(4), rows(planned=4, errors=1)))
    assert table.header == ("policy", "maniskill", "pybullet", "robosuite", "all", "mean of tasks", "errors")
    assert [line[0] for line in table.rows] == ["oracle", "random"]
    assert all(len(line) == len(table.header) for line in table.rows)
    assert table.rows[0][-1] == "4"


def test_several_conditions_get_a_column_and_a_row_each():
    plan = cells(conditions=(Condition("light", 2), Condition()))
    table = formatting.summary_table(tables_of(document(4, plan), rows(plan, 4)))
    assert table.header[:2] == ("policy", "condition")
    assert [line[:2] for line in table.rows] == list(product(("oracle", "random"), ("clean", "light@2")))


def test_many_combinations_have_one_row_for_all_of_them():
    combined = [Condition.of(Perturbation("noise", 1), Perturbation("blur", 1 + n / 100)) for n in range(21)]
    for count, labels in ((20, 21), (21, 2)):
        plan = cells(conditions=(Condition(), *combined[:count]))
        tables = tables_of(document(4, plan), rows(plan, 4))
        summary, tasks = formatting.summary_table(tables), formatting.task_table(tables, "maniskill")
        assert len({line[1] for line in summary.rows}) == len({line[2] for line in tasks.rows}) == labels
        assert all(len(line) == len(summary.header) for line in summary.rows)
        assert all(len(line) == len(tasks.header) for line in tasks.rows)
    of_one = [line for line in tasks.rows if line[:2] == tasks.rows[0][:2]]
    assert [line[2:5] for line in of_one] == [("clean", "4", "4"), ("21 combinations", "84", "84")]


def test_tables_of_tasks_and_times_are_rectangular():
    tables = tables_of(document(4), rows(planned=4))
    for table in (formatting.task_table(tables, "maniskill"), formatting.timing_table(tables.timing)):
        assert table.rows
        assert all(len(line) == len(table.header) for line in table.rows)


def test_one_is_singular_in_every_file_of_a_report(tmp_path):
    plan = cells(("first", "second"), TASKS[:1], (Condition(), Condition("noise", 4)))
    written = write_report(
        run_folder(
            tmp_path / "run",
            document(1, of=plan, compare=CompareEntry(baseline="first", others=("second",))),
            rows(plan, 1),
        )
    )
    for path in (written.paths.html, written.paths.markdown):
        text = path.read_text()
        assert "1 episode" in text
        assert (
            re.findall(r"(?<![\w.,@])1 (?:[a-z]+ )?(?:episode|task|seed|pair|axe|error|level|video|run)s\b", text) == []
        )
