"""What success needs in a benchmark, and which differences it can show."""

import pytest

from robogauntlet.results.report import write_report
from robogauntlet.results.report.sections.benchmark import EPISODES, control_table, sentences
from robogauntlet.results.statistics.sample_size import separate_difference, shrunk_share
from robogauntlet.suites.episode import Condition
from tests.results.synthetic import cells, document, rows_where, run_folder

SEEDS = 60
TASKS = ("libero/goal-0", "libero/goal-1")
BLANK, BLIND, RESAMPLED = (Condition(name, 1) for name in ("blank-instruction", "blind", "resampled"))
PLAN = cells(("expert",), TASKS, (Condition(), BLANK, BLIND, RESAMPLED))


def report_of(tmp_path, is_success, plan=PLAN, **changes):
    return write_report(
        run_folder(tmp_path / "run", document(SEEDS, of=plan, **changes), rows_where(is_success, plan, SEEDS))
    )


@pytest.fixture
def leaking(tmp_path):
    """A policy that never fails but with black images, and in half of the new placements."""

    def is_success(cell, seed):
        return cell.condition != BLIND and (cell.condition != RESAMPLED or seed % 2 == 0)

    return report_of(tmp_path, is_success)


def test_each_control_says_whether_success_needs_what_it_takes_away(leaking):
    instruction, images, states, _ = sentences(leaking.data["benchmark"])
    assert "without the instruction 100 %" in instruction
    assert instruction.endswith("it does not need the instruction (loses less than 5 points).")
    assert "with black images 0 %" in images
    assert images.endswith("it needs images.")
    assert "from newly drawn placements 50 %" in states
    assert states.endswith("it needs the stored states.")


def test_a_loss_between_none_and_a_clear_one_shows_nothing(tmp_path):
    report = report_of(tmp_path, lambda cell, seed: cell.condition != BLANK or seed > 1)
    instruction = next(iter(sentences(report.data["benchmark"])))
    assert instruction.endswith("it is not shown to need the instruction, nor to do without.")


def test_a_policy_that_never_fails_leaves_no_better_one_to_be_shown(leaking):
    *_, saturated = sentences(leaking.data["benchmark"])
    assert saturated == "expert: one that never fails would not be shown to be better in 500 episodes a side."


def test_the_table_has_what_was_lost_and_the_smallest_difference_in_points(tmp_path):
    report = report_of(tmp_path, lambda cell, seed: cell.condition == Condition() and seed % 10 > 0)
    table = control_table(report.data["benchmark"])
    assert table.header == (
        *("policy", "simulator", "clean", "difference shown (points)"),
        *("blank-instruction", "lost", "blind", "lost", "resampled", "lost"),
    )
    ((policy, simulator, clean, shown, _, lost, *_),) = table.rows
    assert (policy, simulator) == ("expert", "libero")
    assert clean.startswith("90 %")
    assert lost.startswith("+90.0")
    assert shown == f"{100 * separate_difference(shrunk_share(108, 120), EPISODES):.1f}"


def test_the_page_and_its_summary_have_the_section_only_with_controls(tmp_path, leaking):
    assert "What success needs here" in leaking.paths.html.read_text(encoding="utf-8")
    assert '"is_saturated": true' in leaking.paths.summary.read_text(encoding="utf-8")
    clean = cells(("expert",), TASKS, (Condition(), Condition("noise", 2)))
    other = report_of(tmp_path / "clean", lambda cell, seed: True, clean)
    assert "What success needs here" not in other.paths.html.read_text(encoding="utf-8")


def test_a_no_skill_baseline_is_left_out(tmp_path):
    report = report_of(tmp_path, lambda cell, seed: True, no_skill_baselines=("expert",))
    assert report.data.get("benchmark") is None
