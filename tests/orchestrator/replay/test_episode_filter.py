"""Selected episodes of a run."""

import pytest

from robogauntlet.orchestrator.replay.episode_filter import EpisodeFilter
from robogauntlet.suites.episode import Condition
from robogauntlet.suites.selection import SelectionError
from tests.results.synthetic import cells, document, row

FAILED = ("failure",)
SYNTHETIC = cells(
    ("p", "q"), ("maniskill/A", "pybullet/B"), (Condition(), Condition("noise", 3), Condition("noise", 5))
)
RUN = document(of=SYNTHETIC)
ROWS = [row(cell, seed, ("failure", "success", "error")[seed % 3]) for cell in SYNTHETIC for seed in range(9)]


def test_all_episodes_are_selected_or_those_of_an_outcome():
    assert len(EpisodeFilter().select(RUN, ROWS)) == len(ROWS)
    chosen = EpisodeFilter(statuses=FAILED).select(RUN, ROWS)
    assert len(chosen) == len(ROWS) / 3
    assert {one.status for one in chosen} == {"failure"}
    assert [one.task for one in chosen] == sorted(one.task for one in chosen)


def test_policies_tasks_conditions_and_statuses_are_selected_by_name_or_pattern():
    choice = EpisodeFilter(("q",), ("pybullet/*",), ("noise@*", "clean"), ("success", "failure"))
    chosen = choice.select(RUN, ROWS)
    assert {(one.policy, one.task) for one in chosen} == {("q", "pybullet/B")}
    assert {(one.axis, one.severity) for one in chosen} == {("clean", 0), ("noise", 3), ("noise", 5)}
    assert {one.status for one in chosen} == {"success", "failure"}


@pytest.mark.parametrize(
    ("choice", "line"),
    [
        (EpisodeFilter(policies=("pp",)), "the run has no policy 'pp'; did you mean 'p'?"),
        (EpisodeFilter(tasks=("maniskill/C",)), "the run has no task 'maniskill/C'; did you mean 'maniskill/A'?"),
        (EpisodeFilter(conditions=("noise@4",)), "the run has no condition 'noise@4'; did you mean 'noise@"),
    ],
)
def test_a_name_that_is_not_in_the_run_is_one_line(choice, line):
    with pytest.raises(SelectionError) as error:
        choice.select(RUN, ROWS)
    assert str(error.value).startswith(line)
