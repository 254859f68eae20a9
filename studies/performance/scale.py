"""The real scheduler over simulated workers: up to a million episodes, a thousand workers, durations over two decades.

No episode is played: a row is made for each and stored in a real store. The clock runs in real time while the scheduler
computes and jumps while it waits. Each message costs the time that is measured on a real Ray first.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from studies.percent import few
from studies.shared import table_of

SIZES = ((10_000, 1_000), (100_000, 10), (100_000, 100), (100_000, 1_000), (1_000_000, 1_000))
"""Episodes and workers."""
CELLS = 400
SHORTEST_S, LONGEST_S = 0.1, 10.0
PENDING = few(1_000)
EVENTS = few(300)

CODE = """
import json, resource, sys
from studies.performance.scale import simulate
result = simulate(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
result["peak_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
print("result:" + json.dumps(result))
"""


def measure() -> list[dict[str, object]]:
    """Simulate each size in its own process."""
    event_s, wait_s = ray_costs()
    print(f"on a real Ray: {1e6 * event_s:.0f} us to send a lease and handle its event,")
    print(f"{1e3 * wait_s:.1f} ms to find which of {PENDING} workers have an event")
    rows: list[dict[str, object]] = []
    for episodes, workers in ((CELLS * few(episodes // CELLS), few(workers)) for episodes, workers in SIZES):
        command = [sys.executable, "-c", CODE, str(episodes), str(workers), str(event_s), str(wait_s / PENDING)]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        line = next(line for line in done.stdout.splitlines() if line.startswith("result:"))
        rows.append({"event_ms": 1e3 * event_s, "wait_ms": 1e3 * wait_s, **json.loads(line.removeprefix("result:"))})
    columns = {"episodes": "{episodes:,}", "workers": "{workers:,}", "simulated time, s": "{makespan_s:,.0f}"}
    columns |= {"a lease, ms": "{event_ms:.2f}"}
    columns |= {"idle": "{idle:.2%}", "episodes a second of the scheduler's own time": "{per_second:,.0f}"}
    table_of(rows, columns | {"its share of the time": "{computing:.0%}", "memory, MiB": "{peak_mib}"})
    return rows


def simulate(episodes: int, workers: int, event_s: float, wait_s: float) -> dict[str, float]:
    """Play episodes of `CELLS` cells with simulated workers, and store the rows."""
    import numpy as np

    from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions
    from robogauntlet.orchestrator.scheduling.work_queue import work_queues
    from robogauntlet.results.store.episode_store import Store
    from robogauntlet.suites.episode import Cell, Condition, Episode, Protocol
    from tests.orchestrator.conftest import RecordingObserver
    from tests.orchestrator.scheduling.simulated_worker_pool import Clock, SimulatedWorkerPool

    rng = np.random.default_rng(0)
    tasks = [f"simulated/Task{i}" for i in range(10)]
    typical = dict(zip(tasks, np.geomspace(2 * SHORTEST_S, LONGEST_S / 2, len(tasks)), strict=True))
    drawn = rng.lognormal(0.0, 0.35, size=1 << 16)
    count = iter(range(2 * episodes))

    def seconds(episode: Episode) -> float:
        return float(np.clip(typical[episode.task] * drawn[next(count) % len(drawn)], SHORTEST_S, LONGEST_S))

    policies = [f"policy{i}" for i in range(CELLS // len(tasks))]
    work = [
        (Cell(policy, policy, task, Protocol(60), Condition()), range(episodes // CELLS))
        for policy in policies
        for task in tasks
    ]
    options = SchedulerOptions(lambda: workers, episode_time_limit_s=120.0, allowed_errors=0)
    observer = RecordingObserver()
    observer.on_results = lambda rows: None
    with tempfile.TemporaryDirectory() as folder:
        store = Store.open_file(Path(folder) / "episodes.sqlite", "scale")
        clock = Clock(time.perf_counter)
        pool = SimulatedWorkerPool(seconds, clock, event_s=event_s, wait_s=wait_s)
        Scheduler(work_queues(work, 3), pool, options, store.add, observer, now=clock).run()
        makespan, computed = clock(), clock.computed + pool.charged_s
        stored = sum(map(len, store.outcomes().values()))
        store.close()
    assert stored == episodes, f"{stored} rows of {episodes} episodes"
    return {
        "episodes": episodes,
        "workers": workers,
        "makespan_s": makespan,
        "idle": 1.0 - pool.busy_s / (makespan * workers),
        "per_second": episodes / computed,
        "computing": computed / makespan,
        "events": pool.event_count,
    }


def ray_costs() -> tuple[float, float]:
    """Time to send a lease and handle its event, and to wait for `PENDING` workers without events (s)."""
    import ray

    from robogauntlet.orchestrator.episodes.lease import Lease
    from robogauntlet.orchestrator.episodes.policy_source import PolicySource
    from robogauntlet.orchestrator.ray_runtime.session import ray_session
    from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
    from robogauntlet.orchestrator.scheduling.worker_pool import EpisodesFinished
    from robogauntlet.suites.episode import Cell, Protocol

    with ray_session(address=None, workers=1):
        pool = RayWorkerPool({"oracle": PolicySource("oracle")})
        cell = Cell("oracle", "oracle", "null/Reach", Protocol(20))
        worker = pool.start("null-0", "null", cell)
        for _ in range(2):
            pool.wait(60.0)
            worker.next_event()
        worker.play(Lease(cell, (0,)))
        event = worker.next_event()
        while isinstance(event, EpisodesFinished) and not event.last:  # the policy is loaded
            event = worker.next_event()
        assert isinstance(event, EpisodesFinished), event
        spent = 0.0
        for seed in range(EVENTS):
            start = time.perf_counter()
            worker.play(Lease(cell, (seed,)))
            spent += time.perf_counter() - start
            pool.wait(60.0)
            start = time.perf_counter()
            worker.next_event()
            spent += time.perf_counter() - start
        pool.end(worker)
        pool.close()

        @ray.remote(num_cpus=0)
        def never() -> None:
            time.sleep(3600)

        pending = [never.options(resources={"nowhere": 1}).remote() for _ in range(PENDING)]
        start = time.perf_counter()
        for _ in range(20):
            ray.wait(pending, num_returns=1, timeout=0, fetch_local=False)
        waited = (time.perf_counter() - start) / 20
        for reference in pending:
            ray.cancel(reference)
    return spent / EVENTS, waited
