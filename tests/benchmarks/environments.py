"""Time from scheduling to the first reset, for workers in the running environment and in a separate one."""

import os
import tempfile
import time
from statistics import median
from typing import Any

from tests.benchmarks.shared import table

TASKS = ("null/Reach", "robosuite/Lift")
TIMES = 5


def measure() -> list[dict[str, object]]:
    """Start workers that open a task and begin an episode; report the median and the slowest start."""
    from robogauntlet.orchestrator.environments.environment import Environment
    from robogauntlet.orchestrator.environments.installer import create
    from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
    from robogauntlet.orchestrator.ray_runtime.session import ray_session
    from robogauntlet.suites.environments import EnvironmentEntry

    os.environ["ROBOGAUNTLET_CONFIG"] = os.devnull
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as folder, ray_session(address=None, workers=2):
        os.environ["ROBOGAUNTLET_ENVIRONMENTS"] = folder
        for task in TASKS:
            simulator, entry = task.partition("/")[0], EnvironmentEntry()
            began = time.perf_counter()
            create(Environment(simulator, entry, "the benchmark"), lambda line: None)
            creating = time.perf_counter() - began
            for place, declared in (("running", {}), ("separate", {simulator: entry})):
                seconds = [_first_reset(task, EnvironmentResolver(declared)) for _ in range(TIMES)]
                rows.append(
                    {
                        "task": task,
                        "environment": place,
                        "created_s": creating if declared else 0.0,
                        "median_s": median(seconds),
                        "most_s": max(seconds),
                    }
                )
    table(
        ("task", "environment", "created in", "to the first reset, median", "slowest"),
        [(task, place, *(f"{seconds:.2f} s" for seconds in times)) for task, place, *times in map(dict.values, rows)],
    )
    return rows


def _first_reset(task: str, environments: Any) -> float:
    """Seconds from the check of the environment and the start of a worker to the beginning of its first episode."""
    from robogauntlet.adapters import catalog
    from robogauntlet.orchestrator.episodes.lease import Lease
    from robogauntlet.orchestrator.episodes.policy_source import PolicySource
    from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
    from robogauntlet.suites.episode import Cell, Protocol, View

    cell = Cell("random", "random", task, Protocol(1, 1, View(("third_person",), 32)))
    began = time.time()
    assert environments.missing_reason(catalog.find(cell.simulator)) is None
    pool = RayWorkerPool({"random": PolicySource("random")}, environments=environments)
    worker = pool.start("worker", cell.simulator, cell)
    events = [worker.next_event(), worker.next_event()]
    assert worker.pending is None, events
    worker.play(Lease(cell, (0,)))
    returned = worker.next_event()
    (result,) = returned.results
    assert result.error is None, result.error
    pool.end(worker)
    pool.close()
    return result.started_at - began
