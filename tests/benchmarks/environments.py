"""From scheduling to the first reset: a worker in the running environment, and one in an environment of its own."""

import os
import tempfile
import time
from statistics import median
from typing import Any

from tests.benchmarks.shared import table

TASKS = ("null/Reach", "robosuite/Lift")
TIMES = 5


def measure() -> list[dict[str, object]]:
    """Start a worker, have it open a task and begin an episode, so often; the slowest start counts as well."""
    from robogauntlet.orchestrator.environments.environment import Environment
    from robogauntlet.orchestrator.environments.installer import create
    from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
    from robogauntlet.orchestrator.ray_runtime.session import ray_session
    from robogauntlet.suites.environments import EnvironmentEntry

    os.environ["ROBOGAUNTLET_CONFIG"] = os.devnull
    found: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as folder, ray_session(address=None, workers=2):
        os.environ["ROBOGAUNTLET_ENVIRONMENTS"] = folder
        for task in TASKS:
            simulator, entry = task.partition("/")[0], EnvironmentEntry()
            began = time.perf_counter()
            create(Environment(simulator, entry, "the benchmark"), lambda line: None)
            making = time.perf_counter() - began
            for place, declared in (("running", {}), ("its own", {simulator: entry})):
                seconds = [_first_reset(task, EnvironmentResolver(declared)) for _ in range(TIMES)]
                found.append(
                    {
                        "task": task,
                        "environment": place,
                        "made_s": making if declared else 0.0,
                        "median_s": median(seconds),
                        "most_s": max(seconds),
                    }
                )
    table(
        ("task", "environment", "made in", "to the first reset, median", "slowest"),
        [(task, place, *(f"{seconds:.2f} s" for seconds in times)) for task, place, *times in map(dict.values, found)],
    )
    return found


def _first_reset(task: str, homes: Any) -> float:
    """Seconds from the check of the environment and the start of a worker to the beginning of its first episode."""
    from robogauntlet.adapters import catalog
    from robogauntlet.orchestrator.episodes.lease import Lease
    from robogauntlet.orchestrator.episodes.policy_source import PolicySource
    from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
    from robogauntlet.suites.episode import Cell, Protocol, View

    cell = Cell("random", "random", task, Protocol(1, 1, View(("third_person",), 32)))
    began = time.time()
    assert homes.missing_reason(catalog.find(cell.simulator)) is None
    pool = RayWorkerPool({"random": PolicySource("random")}, environments=homes)
    worker = pool.start("worker", cell.simulator, cell)
    heard = [worker.next_event(), worker.next_event()]
    assert worker.pending is None, heard
    worker.play(Lease(cell, (0,)))
    returned = worker.next_event()
    (result,) = returned.results
    assert result.error is None, result.error
    pool.end(worker)
    pool.close()
    return result.started_at - began
