"""The scheduler with many simulated workers and failures, in a short time."""

from collections import Counter
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions
from robogauntlet.orchestrator.scheduling.work_queue import work_queues
from robogauntlet.suites.episode import Cell, Protocol
from robogauntlet.suites.resources import Resources
from tests.orchestrator.conftest import RecordingObserver
from tests.orchestrator.scheduling.simulated_worker_pool import Clock, SimulatedWorkerPool


def work(plan):
    return [(Cell(policy, policy, task, Protocol(60)), range(n)) for (task, policy), n in plan.items()]


def play(items, pool, workers, **changes):
    observer, rows = RecordingObserver(), []
    given = {"workers": workers, "episode_time_limit_s": 30.0, "allowed_errors": 10**6}
    chosen = SchedulerOptions(**{**given, **changes})
    Scheduler(work_queues(items, 3), pool, chosen, rows.extend, observer, now=pool.clock).run()
    return rows, observer


@given(
    st.dictionaries(st.tuples(st.sampled_from(["a/1", "a/2", "b/1"]), st.sampled_from("pq")), st.integers(1, 30)),
    st.integers(1, 5),
    st.booleans(),
    st.integers(0, 2**32),
)
@settings(max_examples=200)
def test_every_episode_is_returned_exactly_once_despite_dead_and_hanging_workers(plan, count, shared, seed):
    """A few percent of each failure. An episode becomes an error after three failures in a row when leased alone."""
    random = Random(seed)  # not hypothesis', because the number of draws depends on the scheduler's timing
    pool = SimulatedWorkerPool(
        lambda episode: random.uniform(0.01, 3.0),
        Clock(),
        fate=lambda episode: random.choices(["plays", "dies", "hangs"], [0.94, 0.04, 0.02])[0],
    )
    workers = (lambda: count) if shared else {"a": count, "b": count}
    rows, _ = play(work(plan), pool, workers)
    wanted = {cell.episode(seed).id for cell, seeds in work(plan) for seed in seeds}
    assert Counter(row.episode_id for row in rows) == Counter(wanted)


def test_a_hanging_worker_is_ended_after_the_time_limit():
    pool = SimulatedWorkerPool(
        lambda episode: 1.0, Clock(), fate=lambda episode: "hangs" if pool.clock() < 10.0 else "plays"
    )
    rows, observer = play(work({("a/1", "p"): 5}), pool, {"a": 1})
    assert Counter(row.seed for row in rows) == Counter(range(5))
    assert observer.warnings == ["a-0: an episode took longer than 30 s; its episodes go back into the queue"]
    assert 30.0 < pool.clock() < 60.0


def test_a_worker_with_rare_messages_is_not_mistaken_for_a_hanging_one():
    """Each of a thousand workers sends a message every two seconds, while the time limit is one second."""
    pool = SimulatedWorkerPool(lambda episode: 0.1, Clock())
    rows, observer = play(work({("a/1", "p"): 60_000}), pool, lambda: 1000, episode_time_limit_s=1.0)
    assert len(rows) == 60_000
    assert not observer.warnings


def test_a_clock_jump_ends_no_worker_with_pending_events():
    """As if the scheduler was stopped for an hour while its workers went on."""
    jumped = []

    def jump(episode):
        if episode.seed == 10 and not jumped:
            jumped.append(episode)
            pool.clock.waited += 3600.0
        return "plays"

    pool = SimulatedWorkerPool(lambda episode: 1.0, Clock(), fate=jump)
    rows, observer = play(work({("a/1", "p"): 40}), pool, {"a": 3})
    assert Counter(row.seed for row in rows) == Counter(range(40))
    assert jumped
    assert not observer.warnings


def test_a_simulator_that_cannot_be_opened_does_not_affect_the_others():
    pool = SimulatedWorkerPool(lambda episode: 1.0, Clock(), unavailable=["b"])
    rows, observer = play(work({("a/1", "p"): 5, ("b/1", "p"): 7}), pool, lambda: 2)
    assert Counter(row.simulator for row in rows) == {"a": 5}
    assert observer.skipped == [("b", "not here", 7)]


def test_a_worker_above_the_memory_limit_is_replaced_after_its_lease():
    pool = SimulatedWorkerPool(lambda episode: 1.0, Clock(), memory_bytes=lambda played: 100 * played)
    rows, observer = play(work({("a/1", "p"): 40}), pool, {"a": 1}, resources={"a": Resources(memory_gb=950 / 1024**3)})
    assert Counter(row.seed for row in rows) == Counter(range(40))
    assert len(observer.ready) == 4
    assert not observer.warnings


@pytest.mark.parametrize("workers", [10, 300])
def test_workers_are_busy_with_any_episode_durations(workers):
    """Durations over two decades, some tasks short and some long: idle for less than 2 % of the time between leases."""
    rng = np.random.default_rng(0)
    mean_s = {f"a/{i}": seconds for i, seconds in enumerate(np.geomspace(0.1, 10.0, 9))}
    pool = SimulatedWorkerPool(lambda episode: mean_s[episode.task] * rng.lognormal(0.0, 0.3), Clock())
    rows, _ = play(work({(task, "p"): 20 * workers for task in mean_s}), pool, lambda: workers)
    assert len(rows) == 180 * workers
    assert pool.idle_s / (pool.idle_s + pool.busy_s) < 0.02
