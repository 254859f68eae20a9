"""Promises of the report's section about merging and routing."""

from __future__ import annotations

import json
import re

import pytest

from results.report import Summary, read_merging, write_report
from results.report import merging as words
from results.statistics.rates import Estimate, Interval
from tests.results.report.test_writing import HOSTILE, Page
from tests.results.routed import ROLES, TASKS, evidence, plan, routed_document, routed_rows
from tests.results.synthetic import row, run_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = run_folder(tmp_path_factory.mktemp("merging") / "run", routed_document(), routed_rows())
    write_report(folder)
    return folder


def texts(folder):
    return Page((folder / "report.html").read_text()).text, (folder / "report.md").read_text()


def test_the_section_is_there_only_if_the_suite_asks_for_it(folder, tmp_path):
    without = run_folder(tmp_path / "run", routed_document(merging=None), routed_rows())
    write_report(without)
    for with_it, without_it in zip(texts(folder), texts(without), strict=True):
        assert "Merging and routing" in with_it
        assert "Merging and routing" not in without_it
    assert read_merging(without) is None


def test_html_markdown_and_summary_say_the_same(folder):
    merging = read_merging(folder)
    page, markdown = texts(folder)
    for comparison in merging.routed:
        losses = comparison.overall.losses
        said = [words.points(losses.merging), words.points(losses.routing), words.ratio(losses.retention)]
        for number in [*said, words.share(comparison.router.accuracy)]:
            assert number in page
            assert number in markdown
    summary = Summary.model_validate_json((folder / "summary.json").read_text())
    assert summary.merging == merging


def test_the_section_fetches_nothing_and_runs_nothing(folder):
    text = (folder / "report.html").read_text()
    page = Page(text)
    assert "script" not in page.tags
    assert all(value.startswith(("data:", "#")) for value in page.fetched)
    assert not re.search(r"https?:|url\(|@import", text)


def test_tables_are_rectangular_and_name_every_task(folder):
    merging = read_merging(folder)
    tables = [words.comparison_table(merging), words.overall_table(merging), words.router_table(merging)]
    for comparison in merging.routed:
        tables += [words.compact_table(comparison), words.losses_table(comparison)]
        tables += [words.confusion_table(comparison.router.confusion)]
        tables.append(words.calibration_table(comparison))
    for table in tables:
        assert table.rows
        assert all(len(line) == len(table.header) for line in table.rows)
    assert [line[0] for line in words.compact_table(merging.routed[0]).rows] == [
        *TASKS,
        "maniskill, all",
        "pybullet, all",
        "robosuite, all",
        "all",
    ]


def test_policies_that_do_not_route_have_no_router_but_losses(tmp_path):
    results = [row(cell, seed) for cell in plan() for seed in range(3)]
    folder = run_folder(tmp_path / "run", routed_document(3), results)
    write_report(folder)
    merging = read_merging(folder)
    assert [comparison.router for comparison in merging.routed] == [None, None]
    assert words.compact_table(merging.routed[0]).rows[-1] == ("all", "100 %", "100 %", "100 %", "–", "15")
    for text in texts(folder):
        assert "Merging and routing" in text
        assert "calibration error" not in text


def test_a_run_without_rows_still_has_the_section(tmp_path):
    folder = run_folder(tmp_path / "run", routed_document(2), [])
    write_report(folder)
    line = words.losses_table(read_merging(folder).routed[0]).rows[-1]
    assert line == ("all", "–", "–", "–", "–", "0", "10 missing")


def test_a_script_in_an_inferred_task_is_escaped(tmp_path):
    results = [
        row(cell, 0, **(evidence(HOSTILE) if cell.policy in ROLES.routed else {})) for cell in plan(tasks=TASKS[:1])
    ]
    folder = run_folder(tmp_path / "run", routed_document(1, plan(tasks=TASKS[:1])), results)
    paths = write_report(folder)
    page = Page(paths.html.read_text())
    assert "script" not in page.tags
    assert "<script" not in paths.markdown.read_text()
    json.loads(paths.summary.read_text())


@pytest.mark.parametrize(
    ("estimate", "shown"),
    [
        (None, "–"),
        (Estimate(0.04, Interval(-0.0004, 0.09)), "+4.0 [0.0, 9.0]"),
        (Estimate(-0.0, Interval(-0.05, 0.05)), "+0.0 [-5.0, 5.0]"),
        (Estimate(-0.125, None), "-12.5"),
    ],
)
def test_a_difference_has_a_sign_and_no_negative_zero(estimate, shown):
    assert words.points(estimate) == shown
