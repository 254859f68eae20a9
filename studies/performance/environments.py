"""Time from scheduling to the first reset, for workers in the running environment and in a separate one."""

import os
import tempfile
import time
from statistics import median
from typing import Any

from studies.percent import few
from studies.shared import table_of

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
            create(Environment(simulator, entry, "the benchmark"), lambda line: None)
            for place, declared in (("the running one", {}), ("its own", {simulator: entry})):
                seconds = [_first_reset(task, EnvironmentResolver(declared)) for _ in range(few(TIMES))]
                row = {"task": task, "environment": place}
                rows.append({**row, "median_s": median(seconds), "most_s": max(seconds)})
    columns = {"task": "{task}", "environment": "{environment}", "to the first reset, median, s": "{median_s:.2f}"}
    table_of(rows, columns | {"slowest, s": "{most_s:.2f}"})
    return rows


def _first_reset(task: str, environments: Any) -> float:
    """Seconds from the check of the environment and the start of a worker to the beginning of its first episode."""
    from robogauntlet.adapters import catalog
    from robogauntlet.orchestrator.episodes.lease import Lease
    from robogauntlet.orchestrator.episodes.policy_source import PolicySource
    from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
    from robogauntlet.orchestrator.scheduling.worker_pool import EpisodesFinished
    from robogauntlet.suites.episode import Cell, Protocol, View

    cell = Cell("random", "random", task, Protocol(1, 1, View(("third_person",), 32)))
    began = time.time()
    assert environments.missing_reason(catalog.find(cell.simulator)) is None
    pool = RayWorkerPool({"random": PolicySource("random")}, environments=environments)
    worker = pool.start("worker", cell.simulator, cell)
    events = [worker.next_event(), worker.next_event()]
    assert worker.pending is None, events
    worker.play(Lease(cell, (0,)))
    event = worker.next_event()
    while isinstance(event, EpisodesFinished) and not event.results:  # the policy is loaded
        event = worker.next_event()
    assert isinstance(event, EpisodesFinished), event
    (result,) = event.results
    assert result.error is None, result.error
    pool.end(worker)
    pool.close()
    return result.started_at - began
