"""How policies fail, as sentences, tables and bars, and in the files of a report."""

import json

import pytest

from robogauntlet.results.analysis.failures import COLUMNS, OUTCOMES, build_failures
from robogauntlet.results.record import FailureKind
from robogauntlet.results.report import summary_model, write_report
from robogauntlet.results.report.facts import PHRASES
from robogauntlet.results.report.sections import failures
from robogauntlet.suites.episode import Condition
from tests import ROOT
from tests.results.synthetic import cells, columns_of, document, rows, rows_where, run_folder, with_behaviour

CONDITIONS = (Condition(), Condition("camera-orbit", 2), Condition("camera-orbit", 4))
PLAN = cells(("zoo:experts",), ("maniskill/A",), CONDITIONS)


def outcome(cell, seed):
    return cell.condition == Condition() and seed != 3


def kind(row):
    return "dropped" if row.axis == "clean" else "not-reached" if row.seed < 7 else "unsafe"


def built(of=PLAN, won=outcome, kind=kind):
    results = with_behaviour(rows_where(won, of, 10), kind)
    return build_failures(document(10, of), columns_of(results, COLUMNS))


def test_no_condition_is_said_to_have_the_most_failures_if_another_has_as_many():
    of = cells(("a",), ("maniskill/A",), (Condition("noise", 2), Condition("camera-orbit", 2)))
    (sentence,) = failures.sentences(built(of, won=lambda cell, seed: False, kind=lambda row: "dropped"))
    assert sentence == "a in maniskill: in 20 of 20 failures the robot lost the object far from the goal (dropped)."


def test_a_robot_that_was_at_the_goal_and_left_it_is_not_said_to_have_gone_elsewhere_alone():
    assert PHRASES[FailureKind.MISPLACED].endswith("elsewhere than to the goal, or did not keep it there")


def test_a_robot_that_timed_out_may_have_been_on_its_way_to_the_object():
    assert PHRASES[FailureKind.TIMED_OUT] == "came closer to the object, or to the goal, until time was up"


def test_a_sentence_names_the_most_frequent_kind_and_where_it_fails_most():
    assert failures.sentences(built()) == [
        "zoo:experts in maniskill: in 14 of 21 failures the robot never reached the object or the goal (not-reached); "
        "under camera-orbit, which has the most failures, in 14 of 20."
    ]


def test_a_policy_without_failures_or_kinds_is_said_to_have_none():
    plan = cells(("a", "b", "c"), ("maniskill/A",))

    def of_policy(row):
        return "dropped" if row.policy == "b" else None

    found = failures.sentences(built(plan, lambda cell, seed: cell.policy == "a", of_policy))
    assert found[-1] == "No failure: a in maniskill (10 episodes)."
    assert found[1] == "c in maniskill: 10 failures, none with a known kind."


def test_the_table_has_numbers_shares_and_intervals():
    found = built()
    table = failures.failure_table(found, found.policies[0])
    assert table.header == ("condition", "episodes", "failures", "unsafe", "not-reached", "dropped", "errors")
    assert table.rows[1] == ("camera-orbit", "20", "20", "6: 30 % [10, 64]", "14: 70 % [36, 90]", "–", "0")
    assert [row[0] for row in table.rows] == ["clean", "camera-orbit", "all"]


def test_many_combinations_are_a_few_bars():
    """The bars of a design are by axis, not by point."""
    points = [Condition(f"noise@{n / 100:g}+table@{5 - n / 100:g}", 1) for n in range(1, 300)]
    plan = cells(("a",), ("maniskill/A",), points)
    results = with_behaviour(rows_where(lambda cell, seed: seed, plan, 2))
    found = build_failures(document(2, plan), columns_of(results, COLUMNS))
    names = [bar.name for bar in failures.outcome_bars(found, found.policies[0]).bars]
    assert names == ["combinations", "noise 1.5 or more", "table 2.5 or more"]
    assert " or more, which has the most failures, in " in failures.sentences(found)[0]


def test_a_bar_is_filled_by_all_episodes():
    found = built()
    for bar in failures.outcome_bars(found, found.policies[0]).bars:
        assert sum(segment.width for segment in bar.segments) == pytest.approx(100, abs=0.01)
    assert [segment.text for segment in bar.segments] == ["unsafe: 6 of 20 episodes", "not-reached: 14 of 20 episodes"]


def test_every_outcome_has_a_colour_and_every_kind_a_phrase():
    style = (ROOT / "results/report/report.css").read_text()
    assert [name for name in OUTCOMES if f".outcome-{name} {{ --fill: " not in style] == []
    assert set(failures.PHRASES) == set(FailureKind)


def test_the_files_of_a_report_have_the_section_after_the_success_tables(tmp_path):
    results = with_behaviour(rows_where(outcome, PLAN, 10), kind)
    paths = write_report(run_folder(tmp_path / "run", document(10, PLAN), results)).paths
    page, text = paths.html.read_text(), paths.markdown.read_text()
    assert page.index('id="tasks"') < page.index('id="failures"') < page.index('id="behaviour"')
    assert page.index('id="behaviour"') < page.index('id="robustness"')
    assert text.index("## Success rates") < text.index("## How it fails") < text.index("## How it moves")
    for shown in (page, text):
        assert "in 14 of 21 failures the robot never reached the object or the goal (not-reached)" in shown
        assert "path length (m)" in shown
    summary = summary_model().model_validate_json(paths.summary.read_text())
    assert summary.failures.policies[0].total.failures == 21
    assert summary.behaviour[0].successes == 9


def test_runs_of_earlier_versions_have_no_such_sections(tmp_path):
    paths = write_report(run_folder(tmp_path / "run", document(4), rows(planned=4))).paths
    page, text = paths.html.read_text(), paths.markdown.read_text()
    assert not any(words in page + text for words in ("How it fails", "How it moves", 'id="failures"'))
    content = json.loads(paths.summary.read_text())
    assert (content["failures"], content["behaviour"]) == (None, None)
