"""The scheduling policy, without Ray and without a clock."""

from collections import Counter

import pytest
from hypothesis import assume, given, strategies as st

from robogauntlet.orchestrator.episodes.lease import Lease
from robogauntlet.orchestrator.scheduling.work_queue import LEASE_S, START_S, WorkQueue, next_simulator
from robogauntlet.results.record import EpisodeResult
from robogauntlet.suites.episode import Cell, Protocol

BACKLOGS = st.dictionaries(st.sampled_from("abc"), st.tuples(st.floats(0, 1e6), st.integers(0, 4)))


def cell(task="sim/A", policy="p"):
    return Cell(policy, policy, task, Protocol(10))


def took(lease, seconds):
    return [EpisodeResult.failed_to_run(episode, "x", wall_s=seconds) for episode in lease.episodes()]


def drain(queue, open_task=None):
    while lease := queue.lease(open_task):
        open_task = lease.cell.task
        yield lease
        queue.finished(lease)


@given(
    st.dictionaries(st.tuples(st.sampled_from("ABC"), st.sampled_from("pq")), st.integers(1, 40), min_size=1),
    st.integers(1, 4),
    st.data(),
)
def test_every_episode_is_leased_until_its_result_returns_and_never_twice_at_the_same_time(plan, workers, data):
    work = [(cell(f"sim/{task}", policy), range(n)) for (task, policy), n in plan.items()]
    queue = WorkQueue(work, workers=workers, max_attempts=2)
    back, given_up, out = Counter(), Counter(), set()
    while lease := queue.lease(data.draw(st.sampled_from([None, "sim/A", "sim/B"]))):
        ids = [episode.id for episode in lease.episodes()]
        assert not out & set(ids)
        fate = data.draw(st.sampled_from(["done", "done", "done", "dies"]))
        if fate == "done":
            queue.returned(lease, took(lease, 0.3))
            queue.finished(lease)
            back.update(ids)
        else:
            survived = data.draw(st.integers(0, len(ids) - 1))
            back.update(ids[:survived])
            given_up.update(r.episode_id for r in queue.lost(lease, lease.seeds[survived:], "it died"))
    everything = {c.episode(seed).id for c, seeds in work for seed in seeds}
    assert set(back) | set(given_up) == everything
    assert not set(back) & set(given_up)
    assert set((back + given_up).values()) == {1}


def test_a_worker_keeps_its_open_task_while_that_has_work():
    queue = WorkQueue([(cell("sim/A"), range(5)), (cell("sim/B"), range(50))], workers=1, max_attempts=3)
    assert [lease.cell.task for lease in drain(queue, "sim/A")][:2] == ["sim/A", "sim/A"]


def test_workers_spread_over_tasks():
    queue = WorkQueue([(cell("sim/A"), range(50)), (cell("sim/B"), range(40))], workers=2, max_attempts=3)
    assert {queue.lease(None).cell.task, queue.lease(None).cell.task} == {"sim/A", "sim/B"}


def test_the_longest_work_by_measured_durations_comes_first():
    work = [(cell("sim/A", "p"), range(9)), (cell("sim/A", "q"), range(6)), (cell("sim/B"), range(9))]
    queue = WorkQueue(work, workers=1, max_attempts=3)
    for (one, _), seconds in zip(work, (1.0, 2.0, 0.1), strict=True):
        lease = Lease(one, (0,))
        queue.returned(lease, took(lease, seconds))
    assert queue.waiting_s == pytest.approx(9 * 1.0 + 6 * 2.0 + 9 * 0.1)
    order = [(lease.cell.task, lease.cell.policy) for lease in drain(queue)]
    assert order[0] == ("sim/A", "q")
    assert order[-1] == ("sim/B", "p")


def test_an_idle_worker_helps_with_another_workers_task():
    queue = WorkQueue([(cell("sim/A"), range(50))], workers=2, max_attempts=3)
    queue.lease("sim/A")
    assert queue.lease("sim/B").cell.task == "sim/A"


def test_a_lease_is_one_episode_until_a_duration_is_known_then_lasts_a_fixed_time():
    queue = WorkQueue([(cell(), range(1000))], workers=1, max_attempts=3)
    first = queue.lease(None)
    assert len(first.seeds) == 1
    queue.returned(first, took(first, LEASE_S / 20))
    assert len(queue.lease(None).seeds) == 20


def test_with_many_workers_each_sends_fewer_messages():
    few, many = (WorkQueue([(cell(), range(10**6))], workers=n, max_attempts=3) for n in (10, 1000))
    for queue in (few, many):
        lease = Lease(cell(), (0,))
        queue.returned(lease, took(lease, 0.1))
    for queue, seconds, message_s in ((few, LEASE_S, 0.1), (many, 4.0, 2.0)):
        lease = queue.lease(None)
        assert (len(lease.seeds), lease.message_s) == (seconds * 10, message_s)


def test_leases_shrink_towards_the_end():
    queue = WorkQueue([(cell(), range(64))], workers=2, max_attempts=3)
    first = queue.lease(None)
    queue.returned(first, took(first, 1e-6))
    sizes = [len(lease.seeds) for lease in drain(queue)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] == 16
    assert sizes[-1] == 1


def test_after_a_death_each_episode_of_the_lease_is_played_alone():
    queue = WorkQueue([(cell(), range(8))], workers=1, max_attempts=3)
    first = queue.lease(None)
    queue.returned(first, took(first, 0.01))
    lease = queue.lease(None)
    assert len(lease.seeds) > 1
    assert queue.lost(lease, lease.seeds[1:], "it died") == []
    alone = [queue.lease(None) for _ in lease.seeds[1:]]
    assert sorted(x.seeds for x in alone) == [(seed,) for seed in lease.seeds[1:]]


def test_an_episode_that_alone_kills_its_worker_too_often_is_given_up_with_its_reason():
    queue = WorkQueue([(cell(), range(1))], workers=1, max_attempts=3)
    for attempt in (1, 2):
        lease = queue.lease(None)
        assert lease.attempt == attempt
        assert queue.lost(lease, lease.seeds, "it died") == []
    lease = queue.lease(None)
    (given_up,) = queue.lost(lease, lease.seeds, "it died")
    assert given_up.status == "error"
    assert given_up.error == "WorkerDied: it died (attempts: 3)"
    assert queue.lease(None) is None


def test_dropped_work_is_counted_and_gone():
    queue = WorkQueue([(cell("sim/A"), range(5)), (cell("sim/B"), range(6))], workers=1, max_attempts=3)
    assert queue.drop("sim/A", "not here") == 11
    assert queue.lease(None) is None


def test_a_lease_is_never_empty_even_if_its_cell_is_unmeasured():
    queue = WorkQueue([(cell("sim/A", "p"), range(1)), (cell("sim/A", "q"), range(3))], workers=4, max_attempts=3)
    played = Lease(cell("sim/A", "q"), (0,))
    queue.returned(played, took(played, 1.0))
    assert [len(lease.seeds) for lease in drain(queue)] == [1, 1, 1, 1]


@given(st.lists(st.tuples(st.sampled_from("ABC"), st.integers(1, 30), st.floats(1e-3, 100)), min_size=1, max_size=8))
def test_waiting_episodes_are_all_episodes_minus_leased_ones(plan):
    work = [(cell(f"sim/{task}", f"p{i}"), range(n)) for i, (task, n, _) in enumerate(plan)]
    seconds = {one: s for (one, _), (_, _, s) in zip(work, plan, strict=True)}
    queue = WorkQueue(work, workers=2, max_attempts=3)
    left = {one: len(seeds) for one, seeds in work}
    known = {}
    for lease in drain(queue):
        left[lease.cell] -= len(lease.seeds)
        queue.returned(lease, took(lease, seconds[lease.cell]))
        known[lease.cell] = seconds[lease.cell]
        mean = sum(known.values()) / len(known)
        assert queue.waiting == sum(left.values())
        assert queue.waiting_s == pytest.approx(sum(n * known.get(one, mean) for one, n in left.items()), abs=1e-6)


def test_a_simulator_without_a_worker_comes_first():
    assert next_simulator({"a": (1000.0, 1), "b": (1.0, 0)}, {}) == "b"


def test_then_the_simulator_with_the_most_work_left_per_worker():
    assert next_simulator({"a": (1000.0, 3), "b": (900.0, 1)}, {}) == "b"


def test_a_slot_stays_idle_if_starting_a_worker_takes_longer_than_the_others_need_for_the_rest():
    assert next_simulator({"a": (0.9 * START_S, 1)}, {}) is None
    assert next_simulator({"a": (1.1 * START_S, 1)}, {}) == "a"
    assert next_simulator({"a": (20.0, 3)}, {"a": 7.0}) is None
    assert next_simulator({"a": (20.0, 2)}, {"a": 7.0}) == "a"


@given(st.floats(1, 1e4), st.integers(1, 20), st.floats(0.1, 100))
def test_another_worker_is_started_exactly_if_the_rest_is_then_finished_earlier(waiting_s, workers, start_s):
    assume(abs(waiting_s / workers - start_s) > 1e-6)
    without, with_another = waiting_s / workers, (waiting_s + start_s) / (workers + 1)
    assert (next_simulator({"a": (waiting_s, workers)}, {"a": start_s}) == "a") == (with_another < without)


@given(BACKLOGS, st.dictionaries(st.sampled_from("abc"), st.floats(0, 1e3)))
def test_a_slot_serves_a_simulator_with_work_and_first_one_without_a_worker(backlogs, start_s):
    chosen = next_simulator(backlogs, start_s)
    unattended = {name for name, (waiting_s, workers) in backlogs.items() if waiting_s > 0 and not workers}
    if chosen is not None:
        assert backlogs[chosen][0] > 0
    if unattended:
        assert chosen in unattended
