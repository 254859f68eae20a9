"""Tests of success lost by merging and by routing."""

from __future__ import annotations

import pytest

from robogauntlet.results.statistics.pairs import Pairs, paired_difference
from robogauntlet.suites.episode import Condition
from robogauntlet.suites.schema import MergingEntry
from robogauntlet_mergevla.report.losses import COLUMNS, build_merging
from tests.results.routed import TASKS, evidence, plan, routed_document, routed_rows
from tests.results.synthetic import cells, columns_of, document, row

SIDES = ("experts", "merged-oracle-routed", "merged")
ROLES = MergingEntry(expert="experts", oracle_routed="merged-oracle-routed", routed=("merged",))
LETTERS = {"s": "success", "f": "failure", "e": "error"}


def merging_of(run, results):
    return build_merging(run, columns_of(results, COLUMNS))


def compared(expert, oracle_routed, routed, task=TASKS[0], wrong=()):
    """The comparison of one task, a letter per seed: success, failure, error, or a dot for no row."""
    of = plan(SIDES, (task,))
    results = []
    for cell, letters in zip(of, (expert, oracle_routed, routed), strict=True):
        for seed, letter in enumerate(letters):
            routing = evidence(TASKS[-1] if seed in wrong else task) if cell.policy == "merged" else {}
            if letter != ".":
                results.append(row(cell, seed, LETTERS[letter], **(routing if letter != "e" else {})))
    return merging_of(document(len(expert), of, merging=ROLES), results).routed[0]


def test_losses_are_paired_and_add_up():
    losses = compared("ssssf", "sssff", "ssfsf").overall.losses
    assert (losses.pairs, losses.errors, losses.missing) == (5, 0, 0)
    assert losses.merging == paired_difference(Pairs(3, 1, 0, 1))
    assert losses.routing == paired_difference(Pairs(2, 1, 1, 1))
    assert losses.merging.value + losses.routing.value == pytest.approx(losses.total.value)
    assert losses.retention.value == 3 / 4


def test_a_pair_with_an_error_on_any_side_is_in_no_loss_and_is_counted():
    row_ = compared("ssse", "ssfs", "sess").overall
    assert (row_.losses.pairs, row_.losses.errors, row_.losses.missing) == (2, 2, 0)
    assert row_.losses.merging.value == 0.5
    assert (row_.expert.successes, row_.expert.trials) == (3, 3)


def test_a_pair_without_a_row_on_a_side_is_missing():
    losses = compared("ssss", "ss.s", "sss.").overall.losses
    assert (losses.pairs, losses.errors, losses.missing) == (2, 0, 2)


def test_without_rows_there_is_no_loss():
    found = compared("....", "....", "....")
    assert (found.overall.losses.pairs, found.overall.losses.missing) == (0, 4)
    assert (found.overall.losses.total, found.overall.losses.retention, found.overall.expert.rate) == (None,) * 3


def test_regret_is_what_the_oracle_routed_policy_wins_on_misrouted_pairs():
    regret = compared("ssss", "sssf", "sffs", wrong=(1, 3)).regret
    assert (regret.misrouted, regret.lost.value) == (2, 0.0)
    regret = compared("ssss", "ssss", "sffs", wrong=(1, 2)).regret
    assert (regret.misrouted, regret.lost.value) == (2, 1.0)


def test_tasks_and_simulators_are_in_the_order_of_the_plan():
    found = merging_of(routed_document(), routed_rows()[::-1])
    merged, paper = found.routed
    assert (found.expert, found.oracle_routed) == ("experts", "merged-oracle-routed")
    assert (merged.policy, paper.policy) == ("merged", "merged-paper")
    assert [line.task for line in merged.tasks] == list(TASKS)
    assert [line.simulator for line in merged.simulators] == ["maniskill", "pybullet", "robosuite"]
    assert merged.overall.losses.pairs == sum(line.losses.pairs for line in merged.simulators) == 50


def test_the_same_rows_give_the_same_numbers():
    assert merging_of(routed_document(), routed_rows()) == merging_of(routed_document(), routed_rows())


def test_a_run_whose_suite_asks_for_no_comparison_has_none():
    assert merging_of(routed_document(merging=None), routed_rows()) is None
    assert merging_of(routed_document(plan=()), []) is None


def test_the_comparison_is_made_under_the_clean_condition():
    of = cells(SIDES, TASKS[:1], (Condition("light", 2), Condition()))
    results = [row(cell, 0, "failure" if cell.condition.severity else "success") for cell in of]
    found = merging_of(document(1, of, merging=ROLES), results)
    assert found.condition == Condition()
    assert (found.routed[0].overall.expert.successes, found.routed[0].overall.losses.pairs) == (1, 1)
