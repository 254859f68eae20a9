"""The engine of comparisons: the algebra of contrasts, and what is adjusted with what."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.results.analysis import contrasts as engine
from robogauntlet.results.analysis.contrasts import Question, all_tasks, by_simulator, by_task, contrasts, together
from robogauntlet.results.statistics import pairs as statistics
from robogauntlet.results.statistics.multiplicity import benjamini_hochberg, holm
from robogauntlet.results.statistics.pairs import Pairs, mcnemar_better, mcnemar_worse, pooled

TASKS = ("maniskill/A", "maniskill/B", "pybullet/C", "robosuite/D")
STRATA = (engine.all_pairs, by_simulator, by_task, engine.by_condition)
LEVEL = 0.025


@st.composite
def pairs_of_sides(draw):
    """A row per pair, of any tasks and conditions; at least one."""
    size = draw(st.integers(1, 80))
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    task = generator.choice(TASKS[: draw(st.integers(1, 4))], size)
    first, second = (generator.random(size) < generator.choice([0.1, 0.5, 0.9, 1.0]) for _ in range(2))
    outcomes = [np.where(won, "success", "failure") for won in (first, second)]
    rows = {"task": task, "status": outcomes[0], "status_before": outcomes[1]}
    rows["simulator"] = [name.partition("/")[0] for name in task]
    rows["axis"] = generator.choice(["noise", "blur"], size)
    return pd.DataFrame(rows | {"severity": generator.integers(1, 3, size)})


def asked(*compared, **changes):
    """The contrasts of all comparisons."""
    return contrasts(compared, Question(**{"strata": STRATA, "level": LEVEL} | changes))


def labels(rows):
    return [(row.simulator, row.task, row.axis, row.severity) for row in rows]


@settings(max_examples=60)
@given(pairs_of_sides())
def test_exchanging_the_sides_changes_the_sign_and_nothing_else(pairs):
    swapped = pairs.rename(columns={"status": "status_before", "status_before": "status"})
    for one, other in zip(*asked(pairs, swapped), strict=True):
        counts = other.pairs
        assert one.pairs == Pairs(counts.both, counts.second_only, counts.first_only, counts.neither)
        assert one.difference.value == pytest.approx(-other.difference.value)
        ends = (-other.difference.interval.high, -other.difference.interval.low)
        assert (one.difference.interval.low, one.difference.interval.high) == pytest.approx(ends)
        assert (one.p, one.detectable) == pytest.approx((other.p, other.detectable))


@settings(max_examples=60)
@given(pairs_of_sides())
def test_a_stratum_is_the_sum_of_what_is_in_it(pairs):
    (rows,) = asked(pairs)
    whole, tasks = rows[0], [row for row in rows if row.task is not None]
    assert whole.pairs.trials == len(pairs)
    assert whole.pairs == pooled(row.pairs for row in tasks) == pooled(row.pairs for row in rows if row.condition)
    assert (whole.tasks, {row.tasks for row in tasks}) == (len(tasks), {1})
    for row in rows:
        if row.simulator is not None and row.task is None:
            own = [task for task in tasks if task.simulator == row.simulator]
            assert len(own) == row.tasks > 1
            assert row.pairs == pooled(task.pairs for task in own)


@settings(max_examples=60)
@given(pairs_of_sides(), st.sampled_from([0.025, 0.05, 0.1]), st.sampled_from([None, 0.05, 0.3]))
def test_numbers_are_those_of_the_statistics(pairs, level, margin):
    for row in asked(pairs, level=level, margin=margin)[0]:
        assert row.difference == statistics.paired_difference(row.pairs, 1 - 2 * level)
        assert (row.p, row.detectable) == (statistics.mcnemar(row.pairs), statistics.detectable_drop(row.pairs, level))
        assert row.no_worse == (None if margin is None else statistics.is_no_worse(row.pairs, margin, 1 - 2 * level))


@settings(max_examples=60)
@given(st.lists(pairs_of_sides(), min_size=1, max_size=3), st.sampled_from([holm, benjamini_hochberg]), st.booleans())
def test_all_tests_of_a_question_are_adjusted_together_and_what_is_no_test_has_one(compared, adjust, tests_all):
    rows = [row for own in asked(*compared, adjust=adjust, tests_all=tests_all) for row in own]
    tested = [row for row in rows if tests_all or statistics.can_reject(row.pairs, LEVEL)]
    assert [row.adjusted for row in tested] == list(adjust([row.p for row in tested]))
    assert {row.adjusted for row in rows if row not in tested} <= {1.0}


@settings(max_examples=60)
@given(pairs_of_sides())
def test_a_question_in_one_direction_has_a_p_value_in_each(pairs):
    (rows,) = asked(pairs, test=mcnemar_worse, opposite=mcnemar_better)
    (mirror,) = asked(pairs, test=mcnemar_better)
    assert [row.opposite for row in rows] == [row.adjusted for row in mirror]
    assert all(max(row.adjusted, row.opposite) > 0.05 for row in rows)
    assert {row.opposite for row in asked(pairs)[0]} == {None}


@settings(max_examples=40)
@given(pairs_of_sides(), st.integers(0, 100))
def test_the_order_of_rows_changes_no_number(pairs, seed):
    mixed = pairs.sample(frac=1, random_state=seed)
    (alone,), (again,) = asked(pairs), asked(mixed)
    assert {repr(row) for row in alone} == {repr(row) for row in again}


def test_what_would_repeat_a_stratum_is_left_out():
    rows = {"simulator": "maniskill", "task": "maniskill/A", "status": ["success"] * 9, "status_before": "failure"}
    single = pd.DataFrame(rows)
    (found,) = asked(single, strata=(by_task, all_tasks, by_simulator))
    assert labels(found) == [("maniskill", "maniskill/A", None, None)]
    assert asked(single[:0], strata=(by_task, all_tasks, by_simulator)) == [()]


def test_values_that_are_no_tests_stay_out_of_the_adjustment():
    assert together([[0.01, None], [], [0.02]]) == [[0.02, 1.0], [], [0.02]]
    assert together([]) == []
