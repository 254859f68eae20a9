"""The report's sections about merging and about the inference of tasks."""

from __future__ import annotations

import json

import pytest

from robogauntlet.results.report import formatting as text, summary_model, write_report
from robogauntlet.results.report.sections import routing as inference
from robogauntlet.results.report.templates import table_script
from robogauntlet.results.statistics.rates import Estimate, Interval
from robogauntlet_mergevla.report import section as words
from tests.results.report.test_writing import HOSTILE, Page, assert_self_contained
from tests.results.routed import ROLES, TASKS, evidence, plan, routed_document, routed_rows
from tests.results.synthetic import row, run_folder


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    return write_report(run_folder(tmp_path_factory.mktemp("merging") / "run", routed_document(), routed_rows()))


def routers_of(report):
    return {one.policy: one.router for one in report.data["routing"]}


def texts(report):
    return Page(report.paths.html.read_text()).text, report.paths.markdown.read_text()


def test_the_section_is_there_only_if_the_suite_asks_for_it(report, tmp_path):
    without = write_report(run_folder(tmp_path / "run", routed_document(merging=None), routed_rows()))
    for with_it, without_it in zip(texts(report), texts(without), strict=True):
        assert "Merging and routing" in with_it
        assert "Merging and routing" not in without_it
    assert "merging" not in without.data


def test_html_markdown_and_summary_say_the_same(report):
    merging, routers = report.data["merging"], routers_of(report)
    page, markdown = texts(report)
    for comparison in merging.routed:
        losses = comparison.overall.losses
        numbers = [text.points(losses.merging), text.points(losses.routing), text.rate(losses.retention)]
        for number in [*numbers, text.share(routers[comparison.policy].accuracy)]:
            assert number in page
            assert number in markdown
    summary = summary_model().model_validate_json(report.paths.summary.read_text())
    assert (summary.merging, summary.routing) == (merging, report.data["routing"])


def test_a_policy_that_infers_its_task_has_its_section_whatever_the_suite_compares(report, tmp_path):
    without = write_report(run_folder(tmp_path / "run", routed_document(merging=None), routed_rows()))
    assert without.data["routing"] == report.data["routing"]
    assert [one.policy for one in without.data["routing"]] == ["merged", "merged-paper"]
    for content in texts(without):
        assert "Task inference" in content


def test_the_section_fetches_nothing_and_runs_nothing(report):
    assert_self_contained(report.paths.html.read_text())


def test_headers_of_confusion_matrices_break_between_words(report):
    assert text.words("PandaPickAndPlace-v3") == ("Panda", "Pick", "And", "Place-", "v3")
    assert "Panda<wbr>Pick<wbr>And<wbr>Place-<wbr>v3<wbr></th>" in report.paths.html.read_text()


def test_tables_are_rectangular_and_name_every_task(report):
    merging = report.data["merging"]
    routers = routers_of(report)
    tables = [words.comparison_table(merging, routers), words.overall_table(merging), words.regret_table(merging)]
    for comparison in merging.routed:
        tables += [words.compact_table(comparison, routers[comparison.policy]), words.losses_table(comparison)]
    tables.append(inference.router_table(report.data["routing"]))
    for router in routers.values():
        tables += [inference.confusion_table(router.confusion), inference.calibration_table(router.calibration)]
    for table in tables:
        assert table.rows
        assert all(len(line) == len(table.header) for line in table.rows)
    names = [line[0] for line in words.compact_table(merging.routed[0], None).rows]
    assert names == [*TASKS, "maniskill, all", "pybullet, all", "robosuite, all", "all"]


def test_policies_that_do_not_route_have_no_router_but_losses(tmp_path):
    results = [row(cell, seed) for cell in plan() for seed in range(3)]
    report = write_report(run_folder(tmp_path / "run", routed_document(3), results))
    merging = report.data["merging"]
    assert "routing" not in report.data
    assert words.compact_table(merging.routed[0], None).rows[-1] == ("all", "100 %", "100 %", "100 %", "–", "15")
    for content in texts(report):
        assert "Merging and routing" in content
        assert "calibration error" not in content


def test_a_run_without_rows_still_has_the_section(tmp_path):
    report = write_report(run_folder(tmp_path / "run", routed_document(2), []))
    line = words.losses_table(report.data["merging"].routed[0]).rows[-1]
    assert line == ("all", "–", "–", "–", "–", "0", "10 missing")


def test_a_script_in_an_inferred_task_is_escaped(tmp_path):
    of = plan(tasks=TASKS[:1])
    results = [row(cell, 0, **(evidence(HOSTILE) if cell.policy in ROLES.routed else {})) for cell in of]
    paths = write_report(run_folder(tmp_path / "run", routed_document(1, of), results)).paths
    page = Page(paths.html.read_text())
    assert page.scripts == [table_script().text]
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
    assert text.points(estimate) == shown
