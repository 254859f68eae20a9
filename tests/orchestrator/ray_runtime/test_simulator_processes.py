"""One process per simulator, on any number of cores and for a limited time."""

import time
from collections import Counter

import pytest
import ray

from robogauntlet.orchestrator.ray_runtime import simulator_processes
from robogauntlet.orchestrator.ray_runtime.simulator_processes import ProcessEnded, run_per_simulator

pytestmark = [pytest.mark.ray, pytest.mark.usefixtures("ray_here")]
NAMES = ("null", "pybullet", "robosuite")


def count(numbers, wait_s=0.0):
    for number in range(numbers):
        time.sleep(wait_s)
        yield number


def fail(message):
    yield 0
    raise OSError(message)


@pytest.fixture
def memory_for_one(monkeypatch):
    """Each process needs all the memory of the node."""
    monkeypatch.setattr(simulator_processes, "WORKER_BYTES", float("inf"))


@pytest.fixture
def one_core():
    """Keeps the other cores of `ray_here` busy."""
    holder = ray.remote(num_cpus=ray.cluster_resources()["CPU"] - 1)(Counter).remote()
    ray.get(holder.total.remote())
    yield
    ray.kill(holder)


def test_with_fewer_cores_than_simulators_the_processes_take_turns(one_core):
    found = list(run_per_simulator(count, dict.fromkeys(NAMES, (2,)), silence_s=60.0))
    assert Counter(found) == Counter((name, number) for name in NAMES for number in range(2))


def test_a_process_that_fails_leaves_its_memory_to_the_next(memory_for_one):
    found = list(run_per_simulator(fail, {name: (f"{name} is full",) for name in NAMES}, time_s=60.0))
    assert [(name, item) for name, item in found if item == 0] == [(name, 0) for name, _ in found[::2]]
    assert {(name, item.reason) for name, item in found if isinstance(item, ProcessEnded)} == {
        (name, f"OSError: {name} is full") for name in NAMES
    }


def test_a_process_that_waits_for_memory_is_not_taken_for_a_silent_one(memory_for_one):
    found = list(run_per_simulator(count, dict.fromkeys(NAMES, (4, 1.5)), silence_s=4.0))
    assert Counter(found) == Counter((name, number) for name in NAMES for number in range(4))


def test_a_silent_process_is_ended():
    found = dict(run_per_simulator(count, {"null": (1, 0.0), "pybullet": (1, 60.0)}, silence_s=2.0))
    assert found == {"null": 0, "pybullet": ProcessEnded("no result within 2 s")}


def test_after_its_time_all_processes_are_ended():
    began = time.monotonic()
    cores = ray.cluster_resources()["CPU"]
    found = list(run_per_simulator(count, dict.fromkeys(NAMES, (1000, 0.1)), time_s=5.0))
    assert 5.0 <= time.monotonic() - began < 6.5
    assert len(found) < 200
    until = time.monotonic() + 20.0
    while ray.available_resources().get("CPU", 0) < cores and time.monotonic() < until:
        time.sleep(0.1)
    assert ray.available_resources()["CPU"] == cores
