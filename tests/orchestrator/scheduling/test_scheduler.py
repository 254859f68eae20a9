"""The scheduler on a real Ray: every row exactly once, despite worker failures."""

import os
import signal
import time
from collections import Counter

import pytest

from robogauntlet.orchestrator.episodes.lease import Lease, Readiness
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.ray_runtime.cluster import Placement
from robogauntlet.orchestrator.ray_runtime.session import NoRoom
from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions
from robogauntlet.orchestrator.scheduling.work_queue import work_queues
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.suites.episode import Cell, Protocol
from robogauntlet.suites.resources import Resources

pytestmark = [pytest.mark.ray, pytest.mark.usefixtures("ray_here")]
SOURCES = {name: PolicySource(name) for name in ("oracle", "random", "zero")}


def work(task="null/Reach", seeds=range(40), policies=("oracle",)):
    return [(Cell(policy, policy, task, Protocol(60)), seeds) for policy in policies]


def options(**changes):
    given = {"workers": {"null": 1}, "episode_time_limit_s": 30.0, "allowed_errors": 0}
    return SchedulerOptions(**{**given, **changes})


def play(observer, items, *, max_attempts=3, **changes):
    rows, chosen = [], options(**changes)
    pool = RayWorkerPool(SOURCES, chosen.resources)
    Scheduler(work_queues(items, max_attempts), pool, chosen, rows.extend, observer).run()
    return rows


def gone(pid, within_s=120.0):
    """Whether a process ends within this time; its parent may notice late."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def seeds(rows):
    return Counter(row.seed for row in rows)


def test_every_episode_is_returned_exactly_once_and_is_the_same_with_one_worker_and_with_three(observer):
    items = work(policies=("oracle", "random", "zero"))
    one, three = (play(observer, items, workers={"null": n}) for n in (1, 3))
    assert len(three) == len({row.episode_id for row in three}) == 120
    assert one + three == observer.rows
    assert {row.worker for row in three} <= {"null-0", "null-1", "null-2"}
    assert rows_hash(map(outcome_row, one)) == rows_hash(map(outcome_row, three))


def test_a_killed_worker_only_costs_a_retry(observer):
    killed = []

    def kill(pid):
        killed.append(pid)
        os.kill(pid, signal.SIGKILL)

    def kill_one_that_plays(rows):
        if not killed and len(observer.rows) > 10:
            kill(observer.ready[-1][1].pid)

    def kill_the_next(readiness):
        if len(killed) == 1:
            kill(readiness.pid)

    observer.on_rows, observer.on_ready = kill_one_that_plays, kill_the_next
    rows = play(observer, work("null/Slow", range(40)), workers={"null": 2})
    assert len(killed) == 2
    assert seeds(rows) == Counter(range(40))
    assert all(row.status == "success" for row in rows)
    assert any("the worker process died" in message for message in observer.warnings)
    undisturbed = play(observer, work("null/Slow", range(40)))
    assert sorted(map(outcome_row, rows)) == sorted(map(outcome_row, undisturbed))


def test_an_episode_that_kills_every_worker_becomes_an_error_and_the_others_are_played(observer):
    rows = play(observer, work("null/Crash", range(1, 9)), max_attempts=2, allowed_errors=1)
    assert seeds(rows) == Counter(range(1, 9))
    (error_row,) = [row for row in rows if row.status == "error"]
    assert (error_row.seed, error_row.attempts) == (7, 2)
    assert error_row.error == "WorkerDied: the worker process died (attempts: 2)"


def test_a_worker_reports_once_that_it_has_loaded_a_policy():
    cell, pool = Cell("zero", "zero", "null/Reach", Protocol(20)), RayWorkerPool({"zero": PolicySource("zero")})
    worker = pool.start("null-0", "null", cell)

    def next_event():
        while not pool.wait(1.0):
            pass
        return worker.next_event()

    def lengths():
        worker.play(Lease(cell, (0, 1)))
        events = [next_event()]
        while not events[-1].last:
            events.append(next_event())
        return [len(event.results) for event in events]

    while not isinstance(next_event(), Readiness):
        pass
    assert lengths()[0] == 0
    assert 0 not in lengths()
    pool.end(worker)
    pool.close()


def test_a_stopped_process_is_ended(observer):
    stopped = []

    def stop_one(rows):
        if not stopped:
            stopped.append(observer.ready[0][1].pid)
            os.kill(stopped[0], signal.SIGSTOP)

    observer.on_rows = stop_one
    rows = play(observer, work("null/Slow", range(12)), episode_time_limit_s=10.0)
    assert seeds(rows) == Counter(range(12))
    assert gone(stopped[0])


def test_an_interruption_keeps_returned_rows_and_leaves_no_process(observer):
    def interrupt(_):
        if len(observer.rows) >= 5:
            raise KeyboardInterrupt

    rows, queues = [], work_queues(work("null/Slow", range(100)), 3)
    observer.on_rows = interrupt
    with pytest.raises(KeyboardInterrupt):
        Scheduler(queues, RayWorkerPool(SOURCES), options(), rows.extend, observer).run()
    assert 5 <= len(rows) < 100
    assert all(gone(ready.pid) for _, ready in observer.ready)


def test_a_simulator_that_cannot_be_opened_is_skipped_with_its_reason(observer, monkeypatch):
    items = [*work(), (Cell("oracle", "oracle", "broken/Task", Protocol(10)), range(5))]
    from robogauntlet.adapters import catalog

    null = catalog.find("null")
    monkeypatch.setattr("robogauntlet.adapters.catalog.find", lambda name: null)
    rows = play(observer, items, workers={"null": 1, "broken": 1})
    assert seeds(rows) == Counter(range(40))
    ((name, reason, episodes),) = observer.skipped
    assert (name, episodes) == ("broken", 5)
    assert reason.startswith("unknown simulator 'broken'")


def test_workers_are_replaced_after_a_bounded_number_of_episodes(observer, monkeypatch):
    monkeypatch.setattr("robogauntlet.orchestrator.scheduling.scheduler.RECYCLE_AFTER", 20)
    rows = play(observer, work(seeds=range(40)))
    assert seeds(rows) == Counter(range(40))
    assert len({ready.pid for _, ready in observer.ready}) >= 2


@pytest.mark.nightly
def test_more_workers_than_ray_has_room_for_take_turns(observer):
    """Each worker requests half of the cores. A worker without work makes room."""
    items = [
        (Cell("zero", "zero", task, Protocol(20)), range(6))
        for task in ("null/Reach", "pybullet/PandaReach-v3", "pybullet/PandaPush-v3")
    ]
    rows = []
    sources = {"zero": PolicySource("zero")}
    given = options(workers={"null": 1, "pybullet": 2})
    pool = RayWorkerPool(sources, dict.fromkeys(("null", "pybullet"), Resources(num_cpus=1.5)))
    Scheduler(work_queues(items, 3), pool, given, rows.extend, observer).run()
    assert Counter(row.simulator for row in rows) == {"null": 6, "pybullet": 12}
    assert not observer.warnings


def test_room_is_what_workers_have_left_of_the_cores():
    """Ray has three cores; one of `null` takes two."""
    pool = RayWorkerPool({"zero": PolicySource("zero")}, {"null": Resources(num_cpus=2)})

    def becomes(null, pybullet):
        deadline = time.monotonic() + 60
        while (room := (pool.room("null"), pool.room("pybullet"))) != (null, pybullet) and time.monotonic() < deadline:
            time.sleep(0.1)
        return room == (null, pybullet)

    assert becomes(1, 3)
    worker = pool.start("null-0", "null", Cell("zero", "zero", "null/Reach", Protocol(20)))
    assert becomes(0, 1)
    pool.end(worker)
    assert becomes(1, 3)
    pool.close()


def test_a_worker_is_placeable_elsewhere_if_other_nodes_could_serve_it(monkeypatch):
    """Letters are nodes on which workers are placed; none is any node."""
    pool = RayWorkerPool({"zero": PolicySource("zero")})
    worker = pool.start("null-0", "null", Cell("zero", "zero", "null/Reach", Protocol(20)))
    cases = (("ab", "ab"), ("ab", "b"), ("ab", "bc"), ("ab", ""), ("", "a"), ("", ""))
    elsewhere = []
    for before, now in cases:
        worker.nodes = frozenset(before)
        monkeypatch.setattr(Placement, "nodes", lambda *_, now=now: frozenset(now))
        elsewhere += [(before, now)] if pool.placeable_elsewhere([worker]) else []
    assert elsewhere == [("ab", "bc"), ("ab", ""), ("", "a")]
    pool.end(worker)
    pool.close()


@pytest.mark.nightly
def test_slots_that_are_added_during_the_run_are_used(observer, monkeypatch):
    monkeypatch.setattr("robogauntlet.orchestrator.scheduling.scheduler.GROW_S", 0.1)
    monkeypatch.setattr("robogauntlet.orchestrator.scheduling.work_queue.START_S", 0.0)
    rows = play(observer, work("null/Slow", range(80)), workers=lambda: 3 if len(observer.rows) > 10 else 1)
    assert seeds(rows) == Counter(range(80))
    assert len(observer.ready) == 3


def test_a_worker_above_the_memory_limit_is_replaced(observer):
    rows = play(observer, work(seeds=range(2)), resources={"null": Resources(memory_gb=0.001)})
    assert seeds(rows) == Counter(range(2))
    assert len({ready.pid for _, ready in observer.ready}) >= 2
    assert not observer.warnings


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"num_gpus": 0.5}, "resources.null.num_gpus: expected at most what one node has, 0; got 0.5"),
        ({"num_cpus": 500}, "resources.null.num_cpus: expected at most what one node has, 3; got 500"),
        ({"memory_gb": 9999}, r"resources.null.memory_gb: expected at most what one node has, .*; got 9999"),
    ],
)
def test_resources_that_no_node_has_are_refused(asked, message):
    with pytest.raises(NoRoom, match=message):
        RayWorkerPool(SOURCES, {"null": Resources(**asked)})
