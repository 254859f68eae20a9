"""The scheduler on a real Ray: every row once, whatever dies on the way."""

import os
import signal
import time
from collections import Counter

import pytest

from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.ray_runtime.session import NoRoom
from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions, TooManyErrors
from robogauntlet.orchestrator.scheduling.work_queue import work_queues
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.suites.episode import Cell, Protocol
from robogauntlet.suites.resources import Resources

pytestmark = [pytest.mark.ray, pytest.mark.usefixtures("ray_here")]
SOURCES = {name: PolicySource(name) for name in ("oracle", "random", "untrained")}


def work(task="null/Reach", seeds=range(40), policies=("oracle",)):
    return [(Cell(policy, policy, task, Protocol(60)), seeds) for policy in policies]


def options(**changes):
    given = {"workers": {"null": 2}, "episode_time_limit_s": 30.0, "allowed_errors": 0}
    return SchedulerOptions(**{**given, **changes})


def play(told, items, *, max_attempts=3, **changes):
    rows = []
    chosen = options(**changes)
    Scheduler(
        work_queues(items, max_attempts), RayWorkerPool(SOURCES, chosen.resources), chosen, rows.extend, told
    ).run()
    return rows


def gone(pid, within_s=120.0):
    """Whether a process ends; its parent may take a while to notice."""
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


def test_every_episode_comes_home_once(told):
    rows = play(told, work(policies=("oracle", "random", "untrained")))
    assert len(rows) == len({row.episode_id for row in rows}) == 120
    assert rows == told.rows
    assert {row.worker for row in rows} <= {"null-0", "null-1"}


def test_rows_are_the_same_with_one_worker_and_with_four(told):
    items = work(policies=("oracle", "random", "untrained"))
    one, four = (play(told, items, workers={"null": n}) for n in (1, 4))
    assert rows_hash(map(outcome_row, one)) == rows_hash(map(outcome_row, four))


def test_a_killed_worker_costs_a_retry_and_nothing_else(told):
    killed = []

    def kill(pid):
        killed.append(pid)
        os.kill(pid, signal.SIGKILL)

    def kill_one_that_plays(rows):
        if not killed and len(told.rows) > 10:
            kill(told.ready[-1][1].pid)

    def kill_the_next(readiness):
        if len(killed) == 1:
            kill(readiness.pid)

    told.on_rows, told.on_ready = kill_one_that_plays, kill_the_next
    rows = play(told, work("null/Slow", range(60)))
    assert len(killed) == 2
    assert seeds(rows) == Counter(range(60))
    assert all(row.status == "success" for row in rows)
    assert any("the worker process died" in message for message in told.warnings)
    undisturbed = play(told, work("null/Slow", range(60)))
    assert sorted(map(outcome_row, rows)) == sorted(map(outcome_row, undisturbed))


def test_an_episode_that_kills_its_worker_once_is_done_at_the_next_attempt(told, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "robogauntlet.orchestrator.environments.resolver._ONE_THREAD", {"ROBOGAUNTLET_NULL_MARKER": str(tmp_path)}
    )
    rows = play(told, work("null/Crash", range(15)))
    assert seeds(rows) == Counter(range(15))
    assert {row.status for row in rows} == {"success"}


def test_an_episode_that_kills_every_worker_becomes_an_error_and_the_rest_is_done(told):
    rows = play(told, work("null/Crash", range(1, 9)), max_attempts=2, allowed_errors=1)
    assert seeds(rows) == Counter(range(1, 9))
    (poison,) = [row for row in rows if row.status == "error"]
    assert (poison.seed, poison.error, poison.attempts) == (7, "WorkerDied: the worker process died (attempts: 2)", 2)


def test_a_hung_episode_is_ended_from_outside(told):
    rows = play(told, work("null/Hang", range(5, 9)), episode_time_limit_s=10.0, max_attempts=1, allowed_errors=1)
    assert seeds(rows) == Counter(range(5, 9))
    (hung,) = [row for row in rows if row.status == "error"]
    assert (hung.seed, hung.error) == (7, "WorkerDied: an episode took longer than 10 s (attempts: 1)")


def test_a_stopped_process_is_ended_too(told):
    stopped = []

    def stop_one(rows):
        if not stopped:
            stopped.append(told.ready[0][1].pid)
            os.kill(stopped[0], signal.SIGSTOP)

    told.on_rows = stop_one
    rows = play(told, work("null/Slow", range(12)), episode_time_limit_s=10.0, workers={"null": 1})
    assert seeds(rows) == Counter(range(12))
    assert gone(stopped[0])


def test_too_many_errors_end_the_run_and_keep_what_came(told):
    rows = []
    pool = RayWorkerPool(SOURCES)
    queues = work_queues(work("null/Raise", range(100)), 3)
    scheduler = Scheduler(queues, pool, options(allowed_errors=3), rows.extend, told)
    # As many as were in the message that brought the fourth.
    with pytest.raises(
        TooManyErrors, match=r"\d+ episodes ended in errors, the suite tolerates 3; latest: RuntimeError"
    ):
        scheduler.run()
    assert 4 <= len(rows) < 100
    assert rows == told.rows


def test_an_interruption_keeps_what_came_and_leaves_no_process(told):
    rows = []

    def interrupt(_):
        if len(told.rows) >= 5:
            raise KeyboardInterrupt

    told.on_rows = interrupt
    with pytest.raises(KeyboardInterrupt):
        Scheduler(
            work_queues(work("null/Slow", range(100)), 3), RayWorkerPool(SOURCES), options(), rows.extend, told
        ).run()
    assert 5 <= len(rows) < 100
    assert all(gone(ready.pid) for _, ready in told.ready)


def test_a_sink_that_fails_ends_the_run(told):
    def full(rows):
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        Scheduler(work_queues(work(), 3), RayWorkerPool(SOURCES), options(), full, told).run()


def test_a_simulator_that_cannot_be_opened_is_left_out_with_its_reason(told, monkeypatch):
    items = [*work(), (Cell("oracle", "oracle", "broken/Task", Protocol(10)), range(5))]
    from robogauntlet.adapters import catalog

    null = catalog.find("null")
    monkeypatch.setattr("robogauntlet.adapters.catalog.find", lambda name: null)
    rows = play(told, items, workers={"null": 1, "broken": 1})
    assert seeds(rows) == Counter(range(40))
    ((name, reason, episodes),) = told.left_out
    assert (name, episodes) == ("broken", 5)
    assert reason.startswith("unknown simulator 'broken'")


def test_workers_are_replaced_after_a_bounded_number_of_episodes(told, monkeypatch):
    monkeypatch.setattr("robogauntlet.orchestrator.scheduling.scheduler.RECYCLE_AFTER", 20)
    rows = play(told, work(seeds=range(200)), workers={"null": 1})
    assert seeds(rows) == Counter(range(200))
    assert len({ready.pid for _, ready in told.ready}) >= 3


def test_more_workers_than_there_are_places_take_turns(told):
    """Each asks for half of the places. One with nothing left to do gives its own up."""
    items = [
        (Cell("zero", "zero", task, Protocol(20)), range(6))
        for task in ("null/Reach", "pybullet/PandaReach-v3", "pybullet/PandaPush-v3")
    ]
    rows = []
    sources = {"zero": PolicySource("zero")}
    given = options(workers={"null": 2, "pybullet": 2})
    pool = RayWorkerPool(sources, dict.fromkeys(("null", "pybullet"), Resources(num_cpus=3.0)))
    Scheduler(work_queues(items, 3), pool, given, rows.extend, told).run()
    assert Counter(row.simulator for row in rows) == {"null": 6, "pybullet": 12}
    assert not told.warnings


def test_one_place_for_all_simulators_works_for_one_after_the_other(told):
    items = [(Cell("zero", "zero", task, Protocol(20)), range(6)) for task in ("null/Reach", "pybullet/PandaReach-v3")]
    rows = []
    given = options(workers=lambda: 1)
    Scheduler(work_queues(items, 3), RayWorkerPool({"zero": PolicySource("zero")}), given, rows.extend, told).run()
    assert Counter(row.simulator for row in rows) == {"null": 6, "pybullet": 6}
    assert [simulator for simulator, _ in told.ready] in (["null", "pybullet"], ["pybullet", "null"])


def test_places_that_are_added_while_it_runs_are_taken_up(told, monkeypatch):
    monkeypatch.setattr("robogauntlet.orchestrator.scheduling.scheduler.GROW_S", 0.1)
    monkeypatch.setattr("robogauntlet.orchestrator.scheduling.work_queue.START_S", 0.0)
    rows = play(told, work("null/Slow", range(80)), workers=lambda: 3 if len(told.rows) > 10 else 1)
    assert seeds(rows) == Counter(range(80))
    assert len(told.ready) == 3


def test_a_worker_that_holds_more_memory_than_it_may_is_replaced(told):
    rows = play(told, work(seeds=range(60)), workers={"null": 1}, resources={"null": Resources(memory_gb=1e-9)})
    assert seeds(rows) == Counter(range(60))
    assert len({ready.pid for _, ready in told.ready}) >= 3
    assert not told.warnings


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"num_gpus": 0.5}, "resources.null.num_gpus: expected at most what one node has, 0; got 0.5"),
        ({"num_cpus": 500}, "resources.null.num_cpus: expected at most what one node has, 6; got 500"),
        ({"memory_gb": 9999}, r"resources.null.memory_gb: expected at most what one node has, .*; got 9999"),
    ],
)
def test_what_no_node_has_is_refused_instead_of_waited_for(asked, message):
    with pytest.raises(NoRoom, match=message):
        RayWorkerPool(SOURCES, {"null": Resources(**asked)})
