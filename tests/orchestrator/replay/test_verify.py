"""A run checked against itself."""

import sqlite3
from contextlib import closing

import pytest
from hypothesis import given, strategies as st

from robogauntlet.orchestrator.replay.verify import sample_rows
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import RunStatus
from tests.orchestrator.runs.playing import play
from tests.results.synthetic import cells, execute, row

SUITE = """
name: nulls
policies: [oracle, random]
tasks: [null/Reach]
seeds: {count: 5}
workers: 1
"""
CELL = cells()[0]
ROWS = [row(CELL, seed, "error" if seed % 5 == 4 else "success") for seed in range(40)]


@given(st.integers(0, 40), st.integers(0, 5), st.randoms(use_true_random=False))
def test_the_sample_depends_on_rows_and_seed_and_not_on_their_order(size, seed, shuffle):
    rows = list(ROWS)
    shuffle.shuffle(rows)
    found = sample_rows(iter(rows), size, seed)
    assert found == sample_rows(iter(ROWS), size, seed)
    assert len(found.sample) == min(size, 32)
    assert all(one.status != "error" for one in found.sample)


def test_all_rows_are_counted_and_hashed():
    found = sample_rows(iter(ROWS), 3, 0)
    assert (found.rows, found.rows_hash) == (40, rows_hash(map(outcome_row, ROWS)))


def test_seeds_draw_different_samples_and_every_row_is_drawn_by_some():
    drawn = {one.seed for seed in range(100) for one in sample_rows(iter(ROWS), 4, seed).sample}
    assert len(drawn) == 32


@pytest.fixture(scope="module")
def played(tmp_path_factory, ray_here):
    folder = tmp_path_factory.mktemp("verify")
    (folder / "suite.yaml").write_text(SUITE)
    assert play(folder / "suite.yaml", folder / "run").document.status is RunStatus.COMPLETE
    return folder / "run"


@pytest.mark.ray
def test_an_unchanged_run_passes(played, run_command):
    done = run_command("replay", "--verify", played, "--sample", 4)
    assert done.code == 0, done.err
    assert "10 rows, hash " in done.out
    assert ", as in run.json" in done.out
    assert done.out.count(": the same\n") == 4
    assert done.out.endswith("4 of 10 episodes replayed: all the same\n")


@pytest.mark.ray
def test_a_changed_row_is_found_by_the_hash_and_by_replay(played, run_command):
    with closing(sqlite3.connect(played / "episodes.sqlite")) as database, database:
        (wanted,) = database.execute("select episode_id from episodes where policy = 'oracle' and seed = 1").fetchone()
        (steps,) = database.execute("select steps from episodes where episode_id = ?", (wanted,)).fetchone()
        database.execute("update episodes set steps = 999 where episode_id = ?", (wanted,))
    try:
        done = run_command("replay", "--verify", played, "--sample", 10)
        without = run_command("replay", "--verify", played, "--sample", 0)
    finally:
        execute(played / "episodes.sqlite", f"update episodes set steps = {steps} where episode_id = '{wanted}'")
    assert (done.code, without.code) == (1, 1)
    first, second = done.err.splitlines()
    assert first.startswith("robogauntlet: expected the hash ")
    assert second == f"robogauntlet: {wanted} null/Reach, oracle, clean, seed 1: steps: stored 999, now {steps}"
    assert without.err.splitlines() == [first]


def test_a_folder_that_is_no_run_is_one_line(run_command, tmp_path):
    assert run_command("replay", "--verify", tmp_path).refusal
