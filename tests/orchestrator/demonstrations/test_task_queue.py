"""A task's seeds, leased and returned in any order."""

import sys
from random import Random

import pytest
from hypothesis import given, strategies as st

from robogauntlet.orchestrator.demonstrations.task_queue import (
    MAX_ATTEMPTS,
    MAX_DEATHS_IN_A_ROW,
    CollectionQueue,
    CollectionTask,
    PlayedSeed,
)
from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions
from robogauntlet.policies.training.dataset_writer import Attempt
from robogauntlet.policies.training.lerobot_format import encode_episode
from robogauntlet.suites.episode import Cell, Protocol
from tests.orchestrator.conftest import RecordingObserver
from tests.orchestrator.scheduling.simulated_worker_pool import Clock, SimulatedWorkerPool
from tests.policies.training.synthetic import recording

CELL = Cell("oracle", "0", "null/Reach", Protocol(60))
TASKS = {"a": ("a/1", "a/2"), "b": ("b/1",)}


class Shelf:
    """A writer that stores what is added."""

    def __init__(self):
        self.attempts, self.episodes = [], []

    def add(self, attempt, episode):
        self.attempts.append(attempt)
        self.episodes += [episode.seed] if episode else []

    def flush(self):
        pass

    flush_if_due = flush


def collection(episodes=4, first_seed=100, cell=CELL):
    shelf = Shelf()
    return CollectionTask(cell, episodes, first_seed, shelf), shelf


def queue(episodes=4, workers=2, names=("a/1", "a/2")):
    """A queue, and its tasks."""
    tasks = [collection(episodes, cell=Cell("oracle", "0", task, Protocol(60)))[0] for task in names]
    made = CollectionQueue(tasks)
    made.workers = workers
    return made, tasks


def played(seed, won=True):
    episode = encode_episode(recording(seed, steps=1, size=2, cameras=("wrist",))) if won else None
    return PlayedSeed(Attempt(seed, "success" if won else "failure", 1), episode, 1.0)


@given(st.data())
def test_the_first_successes_by_seed_are_kept_in_any_order(data):
    fails = data.draw(st.sets(st.integers(100, 112), max_size=8))
    made, shelf = collection()
    out = []
    while made.open:
        out += made.lease(data.draw(st.integers(1, 3)))
        seed = out.pop(data.draw(st.integers(0, len(out) - 1)))
        made.accept(played(seed, seed not in fails))
        made.flush_if_due()
    expected = [seed for seed in range(100, 200) if seed not in fails][:4]
    assert shelf.episodes == expected
    assert [attempt.seed for attempt in shelf.attempts] == list(range(100, expected[-1] + 1))


def test_no_more_seeds_are_leased_than_are_missing():
    made, _ = collection(3)
    assert made.lease(8) == (100, 101, 102)
    assert made.lease(8) == ()
    made.accept(played(101, won=False))
    assert made.lease(8) == (103,)


def test_seeds_after_a_gap_are_not_committed():
    made, shelf = collection()
    made.lease(3)
    made.accept(played(101))
    made.writer.flush()
    assert shelf.episodes == []
    made.accept(played(100))
    made.writer.flush()
    assert shelf.episodes == [100, 101]


def test_seeds_of_a_dead_worker_are_leased_again_and_the_cause_becomes_an_error():
    made, shelf = collection(3)
    seeds = made.lease(3)
    for _ in range(MAX_ATTEMPTS - 1):
        made.put_back(seeds, "died")
        assert made.lease(3) == seeds
    made.put_back(seeds, "died")
    assert made.lease(3) == (101, 102, 103)
    made.writer.flush()
    assert shelf.attempts == [Attempt(100, "error", 0, f"died, {MAX_ATTEMPTS} times")]


def test_a_task_whose_workers_only_die_is_given_up():
    made, _ = collection()
    for _ in range(MAX_DEATHS_IN_A_ROW):
        made.put_back(made.lease(1), "died")
    assert not made.open
    assert made.reason == f"died, {MAX_DEATHS_IN_A_ROW} times in a row"


def test_a_task_that_rarely_succeeds_is_given_up():
    made, _ = collection(1)
    while made.open:
        made.accept(played(made.lease(1)[0], won=False))
    assert made.reason == "only 0 of 23 episodes succeeded"
    assert made.wanted == 0


@pytest.mark.parametrize("there", [0, 2])
def test_a_continued_task_starts_after_the_last_committed_seed(there):
    shelf = Shelf()
    shelf.attempts = [Attempt(100 + i, "success", 1) for i in range(there)]
    made = CollectionTask(CELL, 3, 100, shelf)
    assert made.lease(9) == tuple(range(100 + there, 103))


def test_a_worker_keeps_its_open_task_and_another_takes_one_that_is_not_played():
    made, _ = queue(episodes=9)
    first = made.lease(None)
    assert made.lease(first.cell.task).cell == first.cell
    assert made.lease(None).cell != first.cell


def test_a_lease_leaves_seeds_for_other_workers_and_sends_results_separately():
    made, _ = queue(episodes=6, names=("a/1",))
    leases = [made.lease(None) for _ in range(3)]
    assert [len(one.seeds) for one in leases] == [3, 2, 1]
    assert {one.message_s for one in leases} == {0.0}
    assert made.lease(None) is None


def test_a_failure_is_replaced_by_another_seed():
    made, _ = queue(episodes=1, names=("a/1",))
    lease = made.lease(None)
    assert made.waiting == 0
    made.returned(lease, [played(100, won=False)])
    assert made.waiting == 1


def test_a_task_that_cannot_be_opened_leaves_the_others_to_be_played():
    made, (broken, other) = queue()
    assert made.drop(broken.name, "no driver") == 4
    assert (broken.reason, other.reason) == ("no driver", None)
    assert (made.first, made.waiting) == (other.cell, 4)
    assert made.drop(broken.name, "no driver") == 0


def test_expected_time_is_that_of_played_episodes():
    made, _ = queue(episodes=5, names=("a/1",))
    lease = made.lease(None)
    made.returned(lease, [PlayedSeed(Attempt(100, "failure", 1), None, wall_s=7.0)])
    assert made.waiting_s == 7.0 * made.waiting


@given(
    st.integers(1, 4),
    st.sets(st.integers(100, 112), max_size=8),
    st.sets(st.integers(100, 112), max_size=5),
    st.integers(0, 2**32),
)
def test_the_first_successes_by_seed_are_kept_despite_worker_failures(workers, fails, ends, seed):
    random, ended = Random(seed), set()

    def fate(episode):
        if episode.seed not in ends or episode.id in ended:
            return "plays"
        ended.add(episode.id)
        return random.choice(["dies", "hangs"])

    def result(lease, seed, *, wall_s, worker):
        return played(seed, seed not in fails)

    pool = SimulatedWorkerPool(lambda episode: random.uniform(0.1, 9.0), Clock(), fate=fate, result=result)
    tasks = {
        name: [collection(cell=Cell("oracle", "0", task, Protocol(60))) for task in own] for name, own in TASKS.items()
    }
    work = {name: CollectionQueue(made for made, _ in opened) for name, opened in tasks.items()}
    options = SchedulerOptions(lambda: workers, 30.0, allowed_errors=sys.maxsize)
    Scheduler(work, pool, options, lambda results: None, RecordingObserver(), now=pool.clock).run()
    expected = [seed for seed in range(100, 200) if seed not in fails][:4]
    for made, shelf in (each for opened in tasks.values() for each in opened):
        made.writer.flush()
        assert shelf.episodes == expected
        assert [attempt.seed for attempt in shelf.attempts] == list(range(100, expected[-1] + 1))
