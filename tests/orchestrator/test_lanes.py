"""A task's seeds, handed out and taken back in any order."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.lanes import DEATHS_IN_A_ROW, TRIES, Lane
from policies.training.lerobot import encode_episode
from policies.training.writing import Attempt
from suites.vocabulary import Cell, Protocol
from tests.policies.training.synthetic import recording

CELL = Cell("oracle", "0", "null/Reach", Protocol(60))


class Shelf:
    """A writer that remembers."""

    def __init__(self):
        self.attempts, self.episodes = [], []

    def commit(self, attempts, episodes):
        self.attempts += attempts
        self.episodes += [episode.seed for episode in episodes]


def lane(episodes=4, first_seed=100):
    shelf = Shelf()
    return Lane(CELL, episodes, first_seed, shelf, now=lambda: 0.0), shelf


def played(seed, won=True):
    episode = encode_episode(recording(seed, steps=1, size=2, cameras=("wrist",))) if won else None
    return Attempt(seed, "success" if won else "failure", 1), episode


@given(st.data())
def test_the_first_successes_by_seed_are_kept_whatever_the_order(data):
    fails = data.draw(st.sets(st.integers(100, 112), max_size=8))
    made, shelf = lane()
    out = []
    while made.open:
        out += made.lease(data.draw(st.integers(1, 3)))
        seed = out.pop(data.draw(st.integers(0, len(out) - 1)))
        made.take(played(seed, seed not in fails))
        made.flush_if_due()
    expected = [seed for seed in range(100, 200) if seed not in fails][:4]
    assert shelf.episodes == expected
    assert [attempt.seed for attempt in shelf.attempts] == list(range(100, expected[-1] + 1))


def test_no_more_is_handed_out_than_is_missing():
    made, _ = lane(3)
    assert made.lease(8) == (100, 101, 102)
    assert made.lease(8) == ()
    made.take(played(101, won=False))
    assert made.lease(8) == (103,)


def test_what_came_before_its_turn_is_not_committed():
    made, shelf = lane()
    made.lease(3)
    made.take(played(101))
    made.flush()
    assert shelf.episodes == []
    made.take(played(100))
    made.flush()
    assert shelf.episodes == [100, 101]


def test_seeds_of_a_dead_worker_are_handed_out_again_and_the_killer_becomes_an_error():
    made, shelf = lane(3)
    seeds = made.lease(3)
    for _ in range(TRIES - 1):
        made.lose(seeds, "died")
        assert made.lease(3) == seeds
    made.lose(seeds, "died")
    assert made.lease(3) == (101, 102, 103)
    made.flush()
    assert shelf.attempts == [Attempt(100, "error", 0, f"died, {TRIES} times")]


def test_a_task_whose_workers_only_die_is_given_up():
    made, _ = lane()
    for _ in range(DEATHS_IN_A_ROW):
        made.lose(made.lease(1), "died")
    assert not made.open
    assert made.reason == f"died, {DEATHS_IN_A_ROW} times in a row"


def test_a_task_that_hardly_ever_succeeds_is_given_up():
    made, _ = lane(1)
    while made.open:
        made.take(played(made.lease(1)[0], won=False))
    assert made.reason == "only 0 of 23 episodes succeeded"
    assert made.wanted == 0


@pytest.mark.parametrize("there", [0, 2])
def test_a_continued_lane_goes_on_after_the_last_committed_seed(there):
    shelf = Shelf()
    shelf.attempts = [Attempt(100 + i, "success", 1) for i in range(there)]
    made = Lane(CELL, 3, 100, shelf)
    assert made.lease(9) == tuple(range(100 + there, 103))
