"""How close a run came to what it costs at least."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from results.profile import COLUMNS, profile
from results.report.profile import profile_table
from tests.results.synthetic import cells, row

CELLS = cells()
TIMES = {"reset_s": 0.1, "physics_s": 4.0, "render_s": 1.0, "inference_s": 0.5, "wait_s": 0.2, "wall_s": 5.7}


def frame(rows):
    import pandas as pd

    return pd.DataFrame([{name: getattr(one, name) for name in COLUMNS} for one in rows], columns=list(COLUMNS))


def test_episodes_that_cost_alike_are_at_their_bound_but_for_rest_and_waiting():
    (found,) = profile(frame(row(CELLS[0], seed, steps=40, queries=5, **TIMES) for seed in range(4)))
    assert (found.simulator, found.episodes) == ("maniskill", 4)
    assert found.bound_s == pytest.approx(4 * 5.6)
    assert found.slower_s == pytest.approx(0.0)
    assert (found.rest_s, found.wait_s) == (pytest.approx(0.4), pytest.approx(0.8))
    assert found.efficiency == pytest.approx(5.6 / 5.9)


def test_longer_episodes_cost_more_at_least():
    rows = [row(CELLS[0], seed, steps=40, queries=5, **TIMES) for seed in range(3)]
    double = {"physics_s": 8.0, "render_s": 2.0, "inference_s": 1.0, "wall_s": 11.2}
    (found,) = profile(frame([*rows, row(CELLS[0], 3, steps=80, queries=10, **{**TIMES, **double})]))
    assert found.bound_s == pytest.approx(3 * 5.6 + 11.1)


def test_an_episode_on_a_busy_machine_is_slower_than_the_bound():
    rows = [row(CELLS[0], seed, steps=40, queries=5, **TIMES) for seed in range(4)]
    (found,) = profile(frame([*rows, row(CELLS[0], 4, steps=40, queries=5, **{**TIMES, "physics_s": 9, "wall_s": 11})]))
    assert found.slower_s == pytest.approx(5.0)


def test_errors_and_start_up_are_counted_apart():
    rows = [row(CELLS[0], seed, steps=40, queries=5, **TIMES) for seed in range(3)]
    (found,) = profile(frame([*rows, row(CELLS[0], 3, "error", wall_s=7.0, build_s=3.0)]))
    assert (found.errors_s, found.startup_s) == (7.0, 3.0)


def test_what_the_first_answer_after_loading_takes_beyond_others_is_start_up():
    rows = [row(CELLS[0], seed, steps=40, queries=5, **TIMES) for seed in range(4)]
    late = {**TIMES, "inference_s": 2.5, "wall_s": 7.7}
    (found,) = profile(frame([*rows, row(CELLS[0], 4, steps=40, queries=5, load_s=3.0, **late)]))
    assert found.startup_s == pytest.approx(5.0)
    assert found.slower_s == pytest.approx(0.0)
    (other,) = profile(frame([*rows, row(CELLS[0], 4, steps=40, queries=5, **late)]))
    assert other.slower_s == pytest.approx(2.0)


def test_costs_are_not_learnt_from_errors():
    rows = [row(CELLS[0], seed, steps=40, queries=5, **TIMES) for seed in range(2)]
    (found,) = profile(frame([*rows, *(row(CELLS[0], seed, "error", wall_s=7.0) for seed in range(2, 8))]))
    assert found.bound_s == pytest.approx(2 * 5.6)


def test_several_simulators_are_summed():
    rows = [row(cell, seed, steps=40, queries=5, **TIMES) for cell in CELLS for seed in range(2)]
    *each, total = profile(frame(rows))
    assert [one.simulator for one in each] == ["maniskill", "pybullet", "robosuite"]
    assert total.simulator is None
    assert total.measured_s == pytest.approx(sum(one.measured_s for one in each))
    assert profile_table((*each, total)).rows[-1][:2] == ("all", "16")


def test_without_rows_there_is_nothing_to_say():
    assert profile(frame([])) == ()


@given(st.lists(st.tuples(st.floats(0.01, 5), st.floats(0.01, 5), st.integers(1, 100)), min_size=1, max_size=12))
def test_the_parts_add_up_to_what_the_clocks_saw(episodes):
    rows = [
        row(CELLS[0], seed, steps=steps, queries=steps, physics_s=physics, render_s=render, wall_s=physics + render + 1)
        for seed, (physics, render, steps) in enumerate(episodes)
    ]
    (found,) = profile(frame(rows))
    clocks = sum(one.wall_s + one.wait_s for one in rows)
    assert found.measured_s == pytest.approx(clocks)
