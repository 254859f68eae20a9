"""The comparison of policies as text, Markdown, JSON and in the files of a report."""

import json
import re

import pytest

from robogauntlet.results.analysis.comparison import Run
from robogauntlet.results.analysis.pairwise import COLUMNS, PolicyRows, compare_all, compare_policies
from robogauntlet.results.api import open_run
from robogauntlet.results.report import summary_model, write_report
from robogauntlet.results.report.comparison import as_json, render
from robogauntlet.results.report.formatting import TextTable, aligned
from robogauntlet.results.report.pairwise import overview_forest, overview_table, standings_table, table, task_forest
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, columns_of, document, rows_where, run_folder

TASKS = ("maniskill/A", "maniskill/B", "pybullet/C")
SEEDS = 40


def b_is_worse_in_c(cell, seed):
    return seed % 10 != 0 and not (cell.policy == "b" and cell.task == "pybullet/C" and seed % 2)


def run(policies=("a", "b"), tasks=TASKS, **changes):
    plan = cells(policies, tasks)
    rows = columns_of(rows_where(b_is_worse_in_c, plan, SEEDS), COLUMNS)
    return Run("night", document(SEEDS, plan, **changes), rows)


def two(first="a", second="b", **options):
    played = run()
    return compare_policies(PolicyRows.of_run(played, first), PolicyRows.of_run(played, second), **options)


def test_the_text_says_what_was_found_and_how():
    lines = render(two()).splitlines()
    assert lines[0] == "a against b: +16.7 [9.9, 24.0] points, p <0.001, 120 pairs"
    assert lines[1] == "- Success in 120 episodes: a 90 %, b 73 %. The difference is significant at 5 %."
    assert lines[2].startswith("- Tasks with a difference after adjustment: 1 of 3: pybullet/C (+50.0 [")
    assert lines[3] == ""
    assert re.split(r"\s{2,}", lines[4]) == [
        *("task", "pairs", "a", "b", "difference", "only first", "only second", "p", "adjusted p", "detectable")
    ]
    assert [re.split(r"\s{2,}", line)[0] for line in lines[5:10]] == [
        *TASKS[:2],
        "all of maniskill",
        TASKS[2],
        "all tasks",
    ]
    assert "McNemar's exact test, two-sided; adjusted by Holm's method" in lines[-1]


def test_without_a_difference_the_text_says_what_would_have_been_detected():
    text = render(two("a", "a"))
    assert "Success in 120 episodes: a 90 %, a 90 %. No difference is shown. A difference of " in text
    assert "Both have the same content." in text
    assert "Both executed the same actions in 120 of 120 pairs." in text


def test_the_margin_is_mentioned_if_it_was_asked_for():
    assert "no worse than" not in render(two())
    assert "It is shown that a is no worse than b by more than 5 points." in render(two(margin=0.05))
    assert "It is not shown that b is no worse than a by more than 5 points." in render(two("b", "a", margin=0.05))


def test_policies_of_two_runs_are_named_with_their_runs():
    old, new = run(), Run("today", run().document, run().rows)
    found = compare_policies(PolicyRows.of_run(new, "b"), PolicyRows.of_run(old, "b"))
    assert render(found).startswith("today:b against night:b: +0.0 [")


def test_markdown_has_a_heading_and_a_table_that_hold_any_name():
    text = render(two(), "markdown")
    assert text.startswith("### a against b: +16.7 [9.9, 24.0] points, p &lt;0.001, 120 pairs\n")
    assert "| task | pairs | a | b | difference |" in text
    hostile = run(("a|b", "<script>"))
    assert "<script" not in render(compare_all(hostile), "markdown")


def test_json_has_counts_shares_and_sentences():
    plain = json.loads(as_json(two(margin=0.05)))
    (one,) = plain["comparisons"]
    assert one["overall"]["pairs"] == {"both": 88, "first_only": 20, "second_only": 0, "neither": 12}
    assert one["overall"]["difference"]["value"] == pytest.approx(20 / 120)
    assert one["headline"].startswith("a against b")
    assert (plain["alpha"], plain["margin"]) == (0.05, 0.05)


def test_all_pairs_have_an_overview_and_letters_in_every_format():
    found = compare_all(run(("a", "b", "c")))
    assert [row[0] for row in overview_table(found).rows] == ["a against b", "a against c", "b against c"]
    assert {row[0]: row[1] for row in standings_table(found).rows} == {"a": "a", "c": "a", "b": "b"}
    for name in ("text", "markdown"):
        assert "share a letter" in render(found, name)
    assert {row["policy"]: row["letters"] for row in json.loads(as_json(found))["standings"]}["b"] == "b"


def test_a_single_task_is_one_row_with_its_name():
    played = run(tasks=TASKS[:1])
    (one,) = compare_all(played).comparisons
    assert [row[0] for row in table(one).rows] == ["maniskill/A"]


def test_a_forest_plot_has_zero_in_the_middle_and_reaches_every_end():
    found = two(margin=0.1)
    plot = task_forest(found.comparisons[0], found)
    rows = [row for group in plot.groups for row in group.rows]
    assert [row.name for row in rows] == ["A", "B", "all of maniskill", "C", "all tasks"]
    assert all(0 <= row.low <= row.at <= row.high <= 100 for row in rows)
    assert [row.at for row in rows][:2] == [50, 50]
    assert (rows[3].at, rows[3].is_shown, rows[3].is_pooled) == (75, True, False)
    assert plot.ticks == ("-100", "-50", "0", "+50", "+100")
    assert plot.margin == 45
    several = overview_forest(compare_all(run(("a", "b", "c"))))
    assert [row.name for row in several.groups[0].rows] == ["a against b", "a against c", "b against c"]


def test_columns_of_an_aligned_table_are_as_wide_as_their_longest_value():
    lines = aligned(TextTable(("task", "n"), (("a", "1"), ("longer", "100")), 1)).splitlines()
    assert lines == ["task      n", "a         1", "longer  100"]


def report(tmp_path, policies, **changes):
    plan = cells(policies, TASKS)
    folder = run_folder(tmp_path / "run", document(SEEDS, plan, **changes), rows_where(b_is_worse_in_c, plan, SEEDS))
    return write_report(folder).paths


def test_a_report_of_two_policies_compares_them_in_every_file(tmp_path):
    paths = report(tmp_path, ("a", "b"))
    page = paths.html.read_text()
    assert '<a href="#pairwise">A against B</a>' in page
    assert "a against b: +16.7 [9.9, 24.0] points, p &lt;0.001, 120 pairs" in page
    assert page.count('class="forest versus"') == 1
    assert "## A against B" in paths.markdown.read_text()
    (one,) = summary_model().model_validate_json(paths.summary.read_text()).pairwise.comparisons
    assert one.overall.pairs.first_only == 20


def perturbed(tmp_path):
    def is_success(cell, seed):
        return not (cell.policy == "b" and cell.condition.severity == 3 and seed % 2)

    plan = cells(("a", "b"), TASKS[:2], (Condition(), Condition("noise", 1), Condition("noise", 3)))
    return run_folder(tmp_path / "run", document(SEEDS, plan), rows_where(is_success, plan, SEEDS))


def test_perturbed_conditions_are_compared_in_every_file_and_format(tmp_path):
    folder = perturbed(tmp_path)
    paths = write_report(folder).paths
    page, sentence = paths.html.read_text(), "Perturbed conditions with a difference: 1 of 2: noise@3 (+50.0 ["
    assert "Under perturbations, all tasks together" in page
    found = open_run(folder).compare()
    for text in (page, paths.markdown.read_text(), *(render(found, form) for form in ("text", "markdown", "json"))):
        assert sentence in text
        assert "noise@1" in text or '"severity": 1' in text
    (one,) = summary_model().model_validate_json(paths.summary.read_text()).pairwise.comparisons
    assert [(line.axis, line.severity, line.pairs.first_only) for line in one.conditions] == [
        ("noise", 1, 0),
        ("noise", 3, 40),
    ]
    assert one.overall.pairs.trials == 80
    assert "severities are not, since they share their seeds" in render(open_run(folder).compare("a", "b"))


def test_a_clean_comparison_says_nothing_about_perturbations():
    assert "erturb" not in render(two()) + render(two(), "markdown")


def test_compare_of_a_clean_suite_chooses_the_baseline(tmp_path):
    compare = {"baseline": "b", "others": ["a", "c", "d"]}
    paths = report(tmp_path, ("a", "b", "c", "d", "e"), compare=compare)
    page = paths.html.read_text()
    assert re.findall(r"<summary>(\w against \w): ", page) == ["a against b", "c against b", "d against b"]
    assert "All tasks, against b" in page
    assert "### c against b" in paths.markdown.read_text()
    assert summary_model().model_validate_json(paths.summary.read_text()).pairwise.baseline == "b"


def test_a_report_of_many_policies_has_letters(tmp_path):
    page = report(tmp_path, ("a", "b", "c", "d", "e")).html.read_text()
    assert "5 policies have too many pairs to list" in page
    assert "Policies with letters" in page
    assert 'class="forest versus"' not in page


def test_a_report_of_one_policy_compares_nothing(tmp_path):
    paths = report(tmp_path, ("a",))
    assert "A against B" not in paths.html.read_text() + paths.markdown.read_text()
    assert summary_model().model_validate_json(paths.summary.read_text()).pairwise is None
