"""Each report begins with the run at a glance."""

from robogauntlet.results.report import write_report
from robogauntlet.results.report.sections.in_short import FEW
from robogauntlet.results.run_document import RunStatus
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.suites.episode import Condition
from tests.results.report.test_writing import save_video
from tests.results.synthetic import cells, document, row, rows, rows_where, run_folder, with_behaviour

TASKS = ("maniskill/A", "pybullet/B")


def glance(folder):
    """The section as Markdown, and on the page."""
    paths = write_report(folder).paths
    text, page = paths.markdown.read_text(), paths.html.read_text()
    shown = page[page.index("<section") : page.index("</section>")]
    assert '<section id="short">' in shown
    return text[text.index("## In short") : text.index("## Success rates")], shown


def test_it_has_the_rate_of_each_policy_and_the_comparison(tmp_path):
    plan = cells(("a", "b"), TASKS)
    results = rows_where(lambda cell, seed: cell.policy == "a" or seed % 4, plan, 40)
    text, page = glance(run_folder(tmp_path / "run", document(40, plan), results))
    assert "| a | 100 % [95, 100] | 80 |" in text
    assert "| b | 75 % [65, 83] | 80 |" in text
    for shown in (text, page):
        assert "a against b: +25.0 [" in shown
        assert "nothing is said about robustness" in shown
        assert "says little" not in shown


def test_it_has_the_two_most_frequent_reasons_with_a_video(tmp_path):
    plan = cells(("a", "b"), TASKS[:1])
    kinds = {"a": ("dropped",) * 6 + ("misplaced",) * 2, "b": ("not-reached",) * 8}
    results = with_behaviour(rows_where(lambda cell, seed: False, plan, 8), lambda one: kinds[one.policy][one.seed])
    folder = run_folder(tmp_path / "run", document(8, plan), results)
    save_video(folder, next(one for one in results if one.failure == "dropped"))
    text, page = glance(folder)
    reasons = [line for line in text.splitlines() if "failures the robot" in line]
    assert [line[:36] for line in reasons] == [
        "- b in maniskill: in 8 of 8 failures",
        "- a in maniskill: in 6 of 8 failures",
    ]
    assert page.count("<video") == 1


def test_few_episodes_are_as_few_as_their_interval_says():
    interval = wilson_interval(FEW // 2, FEW)
    assert round(100 * (interval.high - interval.low)) == 40


def test_it_warns_of_missing_episodes_errors_and_few_episodes(tmp_path):
    plan = cells(("a",), TASKS)
    run = document(12, plan, status=RunStatus.INTERRUPTED, warnings=("frames are enlarged",))
    results = [*rows(plan[:1], 5), row(plan[1], 0, "error")]
    text, _ = glance(run_folder(tmp_path / "run", run, results))
    for warning in (
        "frames are enlarged.",
        "The run is not complete (interrupted): 18 episodes are missing.",
        "Not played and not counted: 1 error",
        "With fewer than 20 episodes a rate says little: a (5).",
    ):
        assert f"- {warning}" in text.replace("\\", "")


def test_it_says_that_no_difference_is_shown_and_gives_findings_of_robustness(tmp_path):
    plan = cells(("a", "b"), TASKS, (Condition(), Condition("noise", 2), Condition("noise", 4)))
    results = rows_where(lambda cell, seed: not cell.condition.severity or seed % cell.condition.severity, plan, 30)
    text, _ = glance(run_folder(tmp_path / "run", document(30, plan), results))
    assert "No difference is shown: a against b. That is not evidence of none." in text
    assert "nothing is said about robustness" not in text
    assert "a: success drops with severity along noise" in text
