"""How many seeds per task a suite needs."""

import pandas as pd
import pytest

from robogauntlet.results.analysis.episodes_needed import (
    COLUMNS,
    Stored,
    SuiteSize,
    seeds_for_difference,
    seeds_for_width,
)
from robogauntlet.results.report.episodes_needed import assumptions, seeds_table
from robogauntlet.results.statistics.sample_size import pairs_for_power, trials_for_half_width
from robogauntlet.suites.schema import CompareEntry
from tests.results.synthetic import TASKS, cells, row

POLICIES = ("a", "b", "c")
PLAN = cells(POLICIES, TASKS)


def size(**changes):
    """Three policies on four tasks of three simulators, 20 seeds."""
    digests = {cell.policy: cell.policy_digest for cell in PLAN}
    keys = tuple((cell.policy_digest, cell.task, "clean", 0) for cell in PLAN)
    return SuiteSize(**{"policies": tuple(digests.items()), "tasks": TASKS, "seeds": 20, "cells": keys, **changes})


def stored(rows):
    return Stored.from_rows(pd.DataFrame([{name: getattr(one, name) for name in COLUMNS} for one in rows]))


def outcomes(is_success, seeds=20):
    return [
        row(cell, seed, "success" if is_success(cell, seed) else "failure") for cell in PLAN for seed in range(seeds)
    ]


def test_an_interval_over_all_tasks_needs_fewer_seeds_than_one_of_a_task():
    whole, single = seeds_for_width(size(), 0.05, rate=0.8)
    trials = trials_for_half_width(0.8, 0.05)
    assert (whole.tasks, whole.seeds, whole.episodes) == (4, -(-trials // 4), 12 * -(-trials // 4))
    assert (single.tasks, single.seeds, single.episodes) == (1, trials, 12 * trials)
    assert whole.assumed.source == "given"
    assert whole.worker_s is None


def test_no_more_seeds_are_proposed_than_there_are():
    limited = size(most_seeds=62)
    enough, single = seeds_for_width(limited, 0.05, rate=0.8)
    assert enough.seeds == seeds_for_width(size(), 0.05, rate=0.8)[0].seeds == 62
    assert (single.seeds, single.episodes, single.worker_s, single.is_enough) == (None, None, None, False)
    assert seeds_table([enough, single], 20).rows[1][1:3] == ("over 62", "–")
    assert assumptions([enough, single], 20)[1].endswith("; a task has only 62 stored states; add tasks")


def test_without_any_episode_the_worst_case_is_assumed():
    width, difference = seeds_for_width(size(), 0.05)[0], seeds_for_difference(size(), 0.1)[0]
    assert (width.assumed.share, width.assumed.source) == (0.5, "the worst case")
    assert difference.assumed.share == pytest.approx(0.505)


def test_the_stored_policy_and_task_that_need_most_are_assumed():
    """a succeeds always, b fails on half of the seeds of one task, c never succeeds."""

    def half(cell, seed):
        return cell.policy == "a" or (cell.policy == "b" and (cell.task != TASKS[1] or seed % 2 == 0))

    found = stored(outcomes(half))
    whole, single = seeds_for_width(size(), 0.05, stored=found)
    assert whole.assumed.source == "b, 70 of 80 stored episodes"
    assert single.assumed.source == f"b in {TASKS[1]}, 10 of 20 stored episodes"
    assert whole.worker_s == pytest.approx(2.0 * whole.episodes)
    with_c = CompareEntry(baseline="c", others=("a", "b"))
    assert seeds_for_difference(size(comparison=with_c), 0.1, stored=found)[0].assumed.source.startswith("a and c")
    with_a = CompareEntry(baseline="a", others=("b",))
    whole, single = seeds_for_difference(size(comparison=with_a), 0.1, stored=found)
    assert whole.assumed.source == "b and a, 10 of 80 stored pairs"
    assert 10 / 80 < whole.assumed.share < 0.5
    assert single.assumed.source == f"b and a in {TASKS[1]}, 10 of 20 stored pairs"


def test_errors_and_perturbed_episodes_count_in_no_rate():
    rows = [row(PLAN[0], seed, "error") for seed in range(5)] + [row(PLAN[0], seed) for seed in range(5, 9)]
    found = stored(rows)
    assert found.counts(PLAN[0].policy_digest) == {PLAN[0].task: (4, 4)}
    assert found.disagreements(PLAN[0].policy_digest, PLAN[1].policy_digest) == {}


def test_few_stored_pairs_that_agree_leave_room_for_the_difference():
    found = stored(outcomes(lambda cell, seed: True, seeds=30))
    whole = seeds_for_difference(size(), 0.3, stored=found)[0]
    assert whole.assumed.share == 0.3
    assert whole.assumed.source.startswith("no less than the difference; a and b, 0 of 120 stored pairs")


def test_alpha_is_divided_by_the_tests_that_are_adjusted_together():
    whole, single = seeds_for_difference(size(), 0.1, discordance=0.2)
    assert whole.alpha == pytest.approx(0.05 / 3)  # three pairs of policies
    assert single.alpha == pytest.approx(0.05 / 3 / 5)  # four tasks and a simulator with several
    one = seeds_for_difference(size(comparison=CompareEntry(baseline="a", others=("b",))), 0.1, discordance=0.2)[0]
    assert one.alpha == 0.05
    assert 4 * one.seeds == pairs_for_power(0.2, 0.1, step=4) == 168


def test_what_the_seeds_of_the_suite_give_is_said():
    few, many = (seeds_for_difference(size(seeds=n), 0.1, discordance=0.2)[0] for n in (20, 200))
    assert (few.is_enough, many.is_enough) == (False, True)
    assert few.power < 0.8 < many.power
    assert few.reached > 0.1 > many.reached
    few, many = (seeds_for_width(size(seeds=n), 0.05)[0] for n in (20, 200))
    assert (few.is_enough, many.is_enough) == (False, True)
    assert few.reached > 0.05 > many.reached


def test_a_suite_with_one_task_has_one_answer():
    one = size(tasks=TASKS[:1], cells=size().cells[:3])
    assert len(seeds_for_width(one, 0.05)) == len(seeds_for_difference(one, 0.1)) == 1
    assert seeds_for_difference(one, 0.1)[0].alpha == pytest.approx(0.05 / 3)


def test_the_text_names_question_answer_and_assumption():
    asked = size()
    answers = [*seeds_for_width(asked, 0.025, rate=0.8), *seeds_for_difference(asked, 0.1, discordance=0.2)]
    table = seeds_table(answers, 20)
    assert table.header == ("", "seeds", "episodes", "20 seeds give", "enough")
    assert table.rows[0] == ("rate ±2.5 points, 4 tasks", "246", "2,952", "±8.7 points", "no")
    assert table.rows[1][0] == "rate ±2.5 points, one task"
    assert table.rows[2] == ("difference of 10 points, 4 tasks", "54", "648", "15.9 points", "no")
    width, _, difference, _ = assumptions(answers, 20)
    assert width.endswith("assumed that 80 % succeed (given); half of Wilson's 95 % interval")
    assert "McNemar's exact test at 0.017 (0.05 for 3 tests together), power 80 %, with 20 seeds 26 %" in difference
