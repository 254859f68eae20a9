"""How two sides move and fail, as sentences and tables of comparisons."""

from dataclasses import replace

import pytest

from robogauntlet.results.analysis.comparison import Run, compare_runs
from robogauntlet.results.analysis.paired_behaviour import BehaviourComparison, MeasureLine, OutcomeChange
from robogauntlet.results.analysis.pairwise import COLUMNS, compare_all
from robogauntlet.results.report import write_report
from robogauntlet.results.report.comparison import render
from robogauntlet.results.report.paired_behaviour import change_table, difference, measure_table, sentences
from robogauntlet.results.statistics.rates import Estimate, Interval
from tests.results.synthetic import cells, columns_of, document, row, rows, run_folder

PLAN = cells(("a", "b"), ("maniskill/A",))
CHANGES = (OutcomeChange("success", "dropped", 2), OutcomeChange("misplaced", "dropped", 1))


def line(measure="path_length", value=0.0312, ends=(0.01, 0.05), adjusted=0.01):
    return MeasureLine(measure, 30, Estimate(value, ends and Interval(*ends)), 0.002, True, adjusted)


def results(names=("a", "b")):
    """The paths of `a` are longer; both fail at seed 0."""
    kinds = {"a": "dropped", "b": "misplaced"}
    return [
        row(cell, seed, path_length=0.5 + seed / 1000 + 0.1 * (cell.policy == "a") * (1 + seed / 50))
        if seed
        else row(cell, seed, "failure", path_length=0.1, failure=kinds[cell.policy])
        for cell in PLAN
        if cell.policy in names
        for seed in range(15)
    ]


def test_what_is_shown_is_said_with_its_unit_and_how_each_fails():
    found = BehaviourComparison(31, (line(), line("smoothness", adjusted=0.4)), CHANGES)
    assert list(sentences(found, "a", "b", 0.05)) == [
        "Both succeed in 31 pairs; differences shown there, medians of a minus b: path length +0.0312 m [0.01, 0.05].",
        "Failures of a: 1 misplaced.",
        "Failures of b: 3 dropped.",
    ]


def test_a_difference_of_few_pairs_is_not_said_to_be_a_median_other_than_zero():
    found = BehaviourComparison(31, (line("gripper_openings", 0.0, None),), ())
    assert list(sentences(found, "a", "b", 0.05)) == [
        "Both succeed in 31 pairs; differences shown there, medians of a minus b: gripper openings 0."
    ]


def test_nothing_is_claimed_without_evidence_or_with_too_few_pairs():
    (nothing,) = sentences(BehaviourComparison(31, (line(adjusted=0.2),), ()), "a", "b", 0.05)
    assert nothing == "Both succeed in 31 pairs; no difference in how they move there is shown."
    (few,) = sentences(BehaviourComparison(3, (), ()), "a", "b", 0.05)
    assert few == "Both succeed in 3 pairs, too few to compare how they move: 6 start states are needed."


@pytest.mark.parametrize(
    ("measure", "value", "ends", "shown"),
    [
        ("time_to_success", -1.25, (-2, 0.5), "-1.25 s [-2, 0.5]"),
        ("smoothness", 0.125, None, "+0.125"),
        ("contact_force", 0.0, None, "0 N"),
    ],
)
def test_a_difference_has_its_sign_unit_and_interval(measure, value, ends, shown):
    assert difference(line(measure, value, ends)) == shown


def test_tables_have_measures_and_outcomes():
    assert measure_table(BehaviourComparison(31, (line(),), ())).rows == (
        ("path length", "30", "+0.0312 m [0.01, 0.05]", "0.002", "0.010"),
    )
    table = change_table(CHANGES, "a", "b")
    assert table.header == ("rows a, columns b", "dropped")
    assert table.rows == (("success", "2"), ("misplaced", "1"))


def test_a_comparison_of_policies_has_them_in_every_format():
    found = compare_all(Run("night", document(15, PLAN), columns_of(results(), COLUMNS)))
    for text in (render(found), render(found, "markdown")):
        assert "Both succeed in 14 pairs; differences shown there, medians of a minus b: path length +0.1" in text
        assert "Failures of a: 1 dropped." in text
        assert "How they move where both succeed:" in text
        assert "Outcomes of the pairs in which one or both failed:" in text
        assert "Wilcoxon's signed-rank test" in text or text == render(found, "markdown")
    assert '"behaviour": {' in render(found, "json")


def test_a_comparison_of_runs_has_them_where_actions_differ():
    plan = cells(("a",), ("maniskill/A",))
    now = columns_of([replace(one, actions_hash="new") for one in results(("a",))], COLUMNS)
    before = columns_of(results(("a",)), COLUMNS)
    before["path_length"] -= [0.2 + seed / 1000 for seed in range(15)]
    runs = [Run(name, document(15, plan), frame) for name, frame in (("now", now), ("before", before))]
    text = render(compare_runs(*runs), "markdown")
    assert "differences shown there, medians of the run minus the baseline: path length +0.2" in text
    assert "| rows the run, columns the baseline | dropped |" in text
    alike = render(compare_runs(runs[1], runs[1]), "markdown")
    assert "Both succeed" not in alike


def test_a_report_has_them(tmp_path):
    page = write_report(run_folder(tmp_path / "run", document(15, PLAN), results())).paths.html.read_text()
    assert "How they move where both succeed:" in page
    assert "<dt>median difference</dt>" in page


def test_comparisons_of_earlier_runs_are_as_before(tmp_path):
    plan = cells(("a", "b"))
    paths = write_report(run_folder(tmp_path / "run", document(10, plan), rows(plan))).paths
    for text in (paths.html.read_text(), paths.markdown.read_text()):
        assert "Both succeed" not in text
        assert "median difference" not in text
