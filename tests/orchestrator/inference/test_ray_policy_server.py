"""Policy servers on a real Ray."""

import asyncio
import os
import signal
import sys
from collections import Counter

import pytest
import ray

from robogauntlet.orchestrator.environments.resolver import ONE_THREAD
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.inference.ray_policy_server import (
    ServedPolicy,
    choose_inference,
    measure_answer_times,
    served_policies,
    start_servers,
)
from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions
from robogauntlet.orchestrator.scheduling.work_queue import work_queues
from robogauntlet.policies.contract import PolicyInput, PolicySpec
from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.suites.episode import Cell, Protocol, View
from robogauntlet.suites.resources import Inference

pytestmark = [pytest.mark.ray, pytest.mark.usefixtures("ray_here")]
SOURCES = {name: PolicySource(name) for name in ("oracle", "untrained")}
EXPERTS = {"experts": PolicySource("mergevla-experts", {"folder": "zoo:experts"})}
COUNTING = """
import numpy as np

class Counting:
    def reset(self):
        self.queries = 0

    def __call__(self, images, proprioception, instruction):
        self.queries += 1
        return np.full((4, 7), 1e-4 * self.queries)
"""
ONE_WORKER, TWO_WORKERS = {"null": 1, "pybullet": 1}, {"null": 2}


@pytest.fixture
def servers():
    started = []

    def start(sources, **changes):
        started.extend(start_servers(sources, Inference(place="served", **changes)))
        return list(started)

    yield start
    for server in started:
        ray.kill(server)


def work(policy, task="null/Reach", seeds=range(12)):
    return [(Cell(policy, policy, task, Protocol(60)), seeds)]


def play(observer, items, sources=SOURCES, servers=(), workers=ONE_WORKER):
    rows, options = [], SchedulerOptions(workers, episode_time_limit_s=60.0, allowed_errors=0)
    Scheduler(work_queues(items, 3), RayWorkerPool(sources, servers=servers), options, rows.extend, observer).run()
    return rows


def hash_of(rows):
    return rows_hash(map(outcome_row, rows))


def played_here(items, sources=SOURCES):
    """Hash of the rows that a worker makes, which is this without Ray."""
    runner = EpisodeRunner(sources)
    return hash_of(runner.play_one(cell.episode(seed)) for cell, seeds in items for seed in seeds)


def test_only_policies_that_observe_images_are_served():
    assert len(start_servers(SOURCES, Inference())) == 1
    assert start_servers({"oracle": SOURCES["oracle"]}, Inference()) == []


def test_a_server_has_as_many_threads_as_this_process(servers, monkeypatch):
    class Threads:
        def __init__(self, *_):
            pass

        async def numbers(self):
            return {os.environ.get(name) for name in ONE_THREAD}

    monkeypatch.setattr(f"{start_servers.__module__}.Server", Threads)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert ray.get(servers(SOURCES)[0].numbers.remote()) == {"3"}


def test_a_served_policy_makes_the_same_rows_in_batches(observer, servers):
    items = work("untrained") + work("oracle")
    (server,) = servers(SOURCES, batch=2, wait_ms=500)
    assert hash_of(play(observer, items, servers=[server], workers=TWO_WORKERS)) == played_here(items)
    sizes = ray.get(server.batch_sizes.remote())
    assert set(sizes) == {"untrained"}
    assert max(sizes["untrained"]) == 2


def test_simultaneous_episodes_of_a_class_with_reset_do_not_share_its_state(observer, servers, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))  # where the folder is appended
    (tmp_path / "remembering.py").write_text(COUNTING)
    sources = {"mine": PolicySource("python", {"callable": "remembering:Counting", "folder": str(tmp_path)})}
    (server,) = servers(sources, batch=2, wait_ms=500)
    served = play(observer, work("mine"), sources, [server], TWO_WORKERS)
    assert max(ray.get(server.batch_sizes.remote())["mine"]) == 2
    assert {row.status for row in served} == {"failure"}
    assert hash_of(served) == played_here(work("mine"), sources)


def test_a_served_policy_can_be_loaded_before_its_first_episode(servers):
    (server,) = servers(SOURCES)
    assert ray.get(server.batch_sizes.remote()) == {}
    served_policies(server, SOURCES)["untrained"].load()
    assert ray.get(server.batch_sizes.remote()) == {"untrained": {}}


@pytest.mark.nightly
def test_every_replica_is_queried(observer, servers):
    both = servers(SOURCES, replicas=2)

    def end_once_both_workers_have_played(rows):
        if len({row.worker for row in observer.rows}) == 2:
            raise KeyboardInterrupt

    observer.on_rows = end_once_both_workers_have_played
    with pytest.raises(KeyboardInterrupt):
        play(observer, work("untrained", "null/Slow", range(10_000)), servers=both, workers=TWO_WORKERS)
    assert all(ray.get(server.batch_sizes.remote())["untrained"] for server in both)


def test_a_killed_server_costs_no_row(observer, servers):
    (server,) = servers(SOURCES)
    killed = []

    def kill(rows):
        if len(observer.rows) > 3 and not killed:
            killed.append(ray.get(server.pid.remote()))
            os.kill(killed[0], signal.SIGKILL)

    observer.on_rows = kill
    rows = play(observer, work("untrained", "null/Slow"), servers=[server])
    assert killed
    assert Counter(row.seed for row in rows) == Counter(range(12))
    assert hash_of(rows) == played_here(work("untrained", "null/Slow"))


def test_an_episode_that_is_played_again_is_not_forgotten_by_the_end_of_its_first_attempt():
    class SlowToForget:
        def __init__(self):
            self.known = set()

        async def reset(self, name, episodes):
            self.known |= set(episodes)

        async def finish(self, name, episodes):
            await asyncio.sleep(1.0)
            self.known -= set(episodes)

        async def knows(self):
            await asyncio.sleep(2.0)
            return self.known

    server = ray.remote(SlowToForget).options(num_cpus=0, max_concurrency=10).remote()
    policy = ServedPolicy(server, "mine", PolicySpec(PolicyInput.OBSERVATION, 8))
    episode = Cell("mine", "mine", "null/Reach", Protocol(60)).episode(0)
    for _ in range(2):
        policy.reset([episode])
        policy.finish([episode])
    policy.reset([episode])
    assert ray.get(server.knows.remote()) == {episode}
    ray.kill(server)


def test_policies_compute_where_measured_answers_are_faster(monkeypatch):
    times = measure_answer_times(SOURCES, [cell for cell, _ in work("untrained")], Inference(), workers=3)
    assert min(times) > 0
    assert measure_answer_times({"oracle": SOURCES["oracle"]}, [], Inference(), workers=3) is None
    for times, place in (((0.002, 0.001), "served"), ((0.001, 0.002), "worker")):
        monkeypatch.setattr(f"{choose_inference.__module__}.measure_answer_times", lambda *_, times=times: times)
        assert choose_inference(SOURCES, [], Inference(place="auto"), 3, log=print) == place


@pytest.mark.simulator
@pytest.mark.nightly
def test_an_expert_served_without_batches_is_bit_identical_to_one_in_a_worker(observer, servers):
    items = [
        (Cell("experts", "experts", task, Protocol(40, 8, View())), range(1))
        for task in ("pybullet/PandaReach-v3", "pybullet/PandaPush-v3")
    ]
    one_by_one = play(observer, items, EXPERTS, servers(EXPERTS, batch=1))
    assert hash_of(one_by_one) == hash_of(play(observer, items, EXPERTS))
