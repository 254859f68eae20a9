"""The scheduler with many simulated workers and failures, in a short time."""

from collections import Counter
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions, TooManyErrors
from robogauntlet.orchestrator.scheduling.work_queue import work_queues
from robogauntlet.orchestrator.scheduling.worker_pool import WorkerLost
from robogauntlet.suites.resources import Resources
from tests.orchestrator.conftest import RecordingObserver
from tests.orchestrator.scheduling.simulated_worker_pool import Clock, SimulatedWorkerPool, play, work
from tests.results.synthetic import row


@given(
    st.dictionaries(st.tuples(st.sampled_from(["a/1", "a/2", "b/1"]), st.sampled_from("pq")), st.integers(1, 30)),
    st.integers(1, 5),
    st.booleans(),
    st.integers(0, 2**32),
)
@settings(max_examples=100)
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


def test_the_time_to_load_a_policy_does_not_count_as_that_of_an_episode():
    pool = SimulatedWorkerPool(lambda episode: 1.0, Clock(), load_s=100.0)
    rows, observer = play(work({("a/1", "p"): 5, ("a/1", "q"): 5}), pool, {"a": 1})
    assert Counter(row.seed for row in rows) == Counter([*range(5), *range(5)])
    assert not observer.warnings


def test_a_worker_that_does_not_finish_loading_a_policy_is_ended():
    pool = SimulatedWorkerPool(lambda episode: 1.0, Clock(), load_s=1000.0)
    rows, observer = play(work({("a/1", "p"): 1}), pool, {"a": 1})
    assert rows[0].error == "WorkerDied: loading policy 'p' took longer than 210 s (attempts: 3)"
    assert len(observer.warnings) == 3


def test_an_episode_that_was_left_out_is_not_named_as_the_latest_error():
    def result(lease, seed, **fields):
        error = "left out: it needs a scene" if seed % 4 else "RuntimeError: broken"
        return row(lease.cell, seed, "error", error=error, **fields)

    pool = SimulatedWorkerPool(lambda episode: 0.01, Clock(), result=result)
    with pytest.raises(TooManyErrors, match=r"the suite tolerates 3; latest: RuntimeError: broken$"):
        play(work({("a/1", "p"): 103}), pool, {"a": 1}, allowed_errors=3)


def test_a_worker_with_rare_messages_is_not_mistaken_for_a_hanging_one():
    """Each of a thousand workers sends a message every two seconds, while the time limit is one second."""
    pool = SimulatedWorkerPool(lambda episode: 0.1, Clock())
    rows, observer = play(work({("a/1", "p"): 20_000}), pool, lambda: 1000, episode_time_limit_s=1.0)
    assert len(rows) == 20_000
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


class MortalPool(SimulatedWorkerPool):
    """Workers that start before a time end then, if they have not opened their simulator."""

    ends_at = 0.0

    def start(self, name, simulator, first):
        worker = super().start(name, simulator, first)
        if self.clock() < self.ends_at:
            self._events = [event for event in self._events if event[2] is not worker]
            self._at(self.ends_at, worker, WorkerLost("the worker process died"))
        return worker


def test_the_death_of_a_node_on_which_many_workers_open_a_simulator_skips_nothing():
    pool = MortalPool(lambda episode: 1.0, Clock())
    pool.ends_at = 4.0
    rows, observer = play(work({("a/1", "p"): 40}), pool, {"a": 8})
    assert Counter(row.seed for row in rows) == Counter(range(40))
    assert sorted(observer.warnings) == [f"a-{n}: the worker process died while opening a/1" for n in range(8)]
    assert not observer.skipped


def test_a_simulator_in_which_every_worker_dies_is_skipped():
    class DeadlyPool(MortalPool):
        @property
        def ends_at(self):
            return self.clock() + 3.0

    _, observer = play(work({("a/1", "p"): 40}), DeadlyPool(lambda episode: 1.0, Clock()), {"a": 2})
    assert observer.skipped == [("a", "the worker process died while opening a/1, 3 times", 40)]


def test_a_worker_above_the_memory_limit_is_replaced_after_its_lease():
    pool = SimulatedWorkerPool(lambda episode: 1.0, Clock(), memory_bytes=lambda played: 100_000 * played)
    limit = Resources(memory_gb=0.001)  # 1,073,741 bytes
    rows, observer = play(work({("a/1", "p"): 40}), pool, {"a": 1}, resources={"a": limit})
    assert Counter(row.seed for row in rows) == Counter(range(40))
    assert len(observer.ready) == 4
    assert not observer.warnings


class TimelinePool(SimulatedWorkerPool):
    """Records after each assignment the number of workers and the time of waiting episodes per simulator (s)."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.timeline, self.queues = [], {}

    def wait(self, timeout_s):
        workers = Counter(worker.name.partition("-")[0] for worker in self.alive)
        waiting = {name: queue.waiting_s for name, queue in self.queues.items() if queue.waiting}
        self.timeline.append((self.clock(), workers, waiting))
        return super().wait(timeout_s)


EPISODE_S, STARTUP_S = {"a": 1.7, "b": 0.7, "c": 1.2}, 8.0
"""Three simulators that need about 250 s, 105 s and 180 s for 150 episodes."""


def timeline(workers, episodes=150):
    random = Random(0)
    pool = TimelinePool(
        lambda episode: EPISODE_S[episode.simulator] * random.uniform(0.5, 1.5), Clock(), start_s=STARTUP_S
    )
    items = work({(f"{name}/{task}", "p"): episodes // 3 for name in EPISODE_S for task in range(3)})
    pool.queues = work_queues(items, 3)
    options = SchedulerOptions(workers=workers, episode_time_limit_s=60.0, allowed_errors=0)
    rows = []
    Scheduler(pool.queues, pool, options, rows.extend, RecordingObserver(), now=pool.clock).run()
    assert Counter(row.simulator for row in rows) == dict.fromkeys(EPISODE_S, episodes)
    return pool


def test_with_fewer_cores_than_simulators_no_core_idles_while_another_worker_would_help():
    pool = timeline(lambda: 2)
    for _, workers, waiting in pool.timeline:
        if workers.total() < 2:
            assert all(workers[name] and left / workers[name] < STARTUP_S + 3.0 for name, left in waiting.items())
    assert max(workers.total() for _, workers, _ in pool.timeline) == 2
    played_s = 150 * sum(EPISODE_S.values())
    assert pool.clock() < played_s / 2 + 2 * STARTUP_S + STARTUP_S


def test_the_last_simulator_gets_a_second_worker_for_its_last_twenty_episodes():
    """When the other is done, twenty of 1.7 s wait: 34 s with one worker, 21 s with two of which one starts in 8 s."""
    random = Random(0)
    pool = TimelinePool(lambda episode: random.uniform(1.0, 2.4), Clock(), start_s=STARTUP_S)
    play(work({("a/1", "p"): 25, ("b/1", "p"): 5}), pool, lambda: 2)
    assert max(workers["a"] for _, workers, _ in pool.timeline) == 2
    assert pool.clock() < 42.0


@pytest.mark.parametrize("seed", range(8))
def test_a_simulator_that_is_done_keeps_no_worker_from_the_others(seed):
    """Sums of expected times, of which each played episode is subtracted, end near 0 and not always at it."""
    random = Random(seed)
    pool = TimelinePool(lambda episode: random.uniform(0.5, 1.5), Clock(), start_s=STARTUP_S)
    play(work({("a/1", "p"): 20, ("a/1", "q"): 20, ("b/1", "p"): 200}), pool, lambda: 2)
    assert max(workers["b"] for _, workers, _ in pool.timeline) == 2


def test_the_last_episode_of_a_dead_worker_is_left_to_the_others():
    fates = iter(["dies"])
    pool = TimelinePool(
        lambda episode: 1.0,
        Clock(),
        start_s=20.0,
        fate=lambda episode: next(fates, "plays") if episode.seed == 39 else "plays",
    )
    rows, observer = play(work({("a/1", "p"): 40}), pool, lambda: 4)
    assert len(rows) == 40
    assert len(observer.ready) == 4


def test_a_run_does_not_wait_for_workers_that_have_nothing_to_play():
    class SlowSecondStart(SimulatedWorkerPool):
        def start(self, name, simulator, first):
            self._start_s = 1000.0 if self.alive else 8.0
            return super().start(name, simulator, first)

    pool = SlowSecondStart(lambda episode: 1.0, Clock())
    rows, _ = play(work({("a/1", "p"): 10}), pool, {"a": 2}, episode_time_limit_s=5000.0)
    assert len(rows) == 10
    assert pool.clock() < 100.0


def test_no_more_workers_run_than_memory_allows():
    pool = timeline(lambda: 1, episodes=30)
    assert max(workers.total() for _, workers, _ in pool.timeline) == 1


@pytest.mark.parametrize("workers", [10, 100])
def test_workers_are_busy_with_any_episode_durations(workers):
    """Durations over two decades, some tasks short and some long: idle for less than 2 % of the time between leases."""
    rng = np.random.default_rng(0)
    mean_s = {f"a/{i}": seconds for i, seconds in enumerate(np.geomspace(0.1, 10.0, 9))}
    pool = SimulatedWorkerPool(lambda episode: mean_s[episode.task] * rng.lognormal(0.0, 0.3), Clock())
    rows, _ = play(work({(task, "p"): 20 * workers for task in mean_s}), pool, lambda: workers)
    assert len(rows) == 180 * workers
    assert pool.idle_s / (pool.idle_s + pool.busy_s) < 0.02
