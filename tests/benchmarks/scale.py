"""The real scheduler over simulated workers: up to a million episodes, a thousand workers, durations over two decades.

Nothing is played; a row is made for each episode, and a real store keeps it. Time runs as real time does while the
scheduler computes and jumps while it waits, and each message is charged what hearing one costs on a real Ray, measured
first.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.benchmarks.shared import table

SIZES = ((10_000, 1_000), (100_000, 10), (100_000, 100), (100_000, 1_000), (1_000_000, 1_000))
"""Episodes and workers."""
CELLS = 400
SHORTEST_S, LONGEST_S = 0.1, 10.0
PENDING = 1_000
WORDS = 300

CODE = """
import json, resource, sys
from tests.benchmarks.scale import simulate
found = simulate(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]))
found["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
print("found:" + json.dumps(found))
"""


def measure() -> list[dict[str, object]]:
    """Simulate each size in a process of its own."""
    event_s, wait_s = hearing_costs()
    print(f"on a real Ray: {1e6 * event_s:.0f} us to hand out a lease and handle its event,")
    print(f"{1e3 * wait_s:.1f} ms to look who of {PENDING} has something to say")
    rows: list[dict[str, object]] = []
    for episodes, workers in SIZES:
        command = [sys.executable, "-c", CODE, str(episodes), str(workers), str(event_s), str(wait_s / PENDING)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        line = next(line for line in done.stdout.splitlines() if line.startswith("found:"))
        rows.append({"event_s": event_s, "wait_s": wait_s, **json.loads(line.removeprefix("found:"))})
    table(
        ("episodes", "workers", "simulated time", "idle", "scheduler's episodes/s", "its share of the time", "peak MB"),
        [
            (
                f"{row['episodes']:,}",
                row["workers"],
                f"{row['makespan_s']:.0f} s",
                f"{row['idle']:.2%}",
                f"{row['per_second']:.0f}",
                f"{row['computing']:.0%}",
                row["peak_mb"],
            )
            for row in rows
        ],
    )
    return rows


def simulate(episodes: int, workers: int, event_s: float, wait_s: float) -> dict[str, float]:
    """Play so many episodes of `CELLS` cells on so many simulated workers, into a store."""
    import numpy as np

    from robogauntlet.orchestrator.scheduling.scheduler import Scheduler, SchedulerOptions
    from robogauntlet.orchestrator.scheduling.work_queue import work_queues
    from robogauntlet.results.store.episode_store import Store
    from robogauntlet.suites.episode import Cell, Condition, Protocol
    from tests.orchestrator.conftest import RecordingObserver
    from tests.orchestrator.scheduling.simulated_worker_pool import Clock, SimulatedWorkerPool

    rng = np.random.default_rng(0)
    tasks = [f"simulated/Task{i}" for i in range(10)]
    typical = dict(zip(tasks, np.geomspace(2 * SHORTEST_S, LONGEST_S / 2, len(tasks)), strict=True))
    drawn = rng.lognormal(0.0, 0.35, size=1 << 16)
    count = iter(range(2 * episodes))

    def seconds(episode: object) -> float:
        return float(np.clip(typical[episode.task] * drawn[next(count) % len(drawn)], SHORTEST_S, LONGEST_S))  # type: ignore[attr-defined]

    policies = [f"policy{i}" for i in range(CELLS // len(tasks))]
    work = [
        (Cell(policy, policy, task, Protocol(60), Condition()), range(episodes // CELLS))
        for policy in policies
        for task in tasks
    ]
    options = SchedulerOptions(lambda: workers, episode_time_limit_s=120.0, allowed_errors=0)
    told = RecordingObserver()
    told.on_results = lambda rows: None  # type: ignore[method-assign]
    with tempfile.TemporaryDirectory() as folder:
        store = Store.open_file(Path(folder) / "episodes.sqlite", "scale")
        clock = Clock()
        pool = SimulatedWorkerPool(seconds, clock, event_s=event_s, wait_s=wait_s)
        Scheduler(work_queues(work, 3), pool, options, store.add, told, now=clock).run()
        makespan, computed = clock(), clock.computed + pool.charged_s
        stored = sum(store.status_counts().values())
        store.close()
    assert stored == episodes, f"{stored} rows of {episodes} episodes"
    return {
        "episodes": episodes,
        "workers": workers,
        "makespan_s": makespan,
        "idle": 1.0 - pool.busy_s / (makespan * workers),
        "per_second": episodes / computed,
        "computing": computed / makespan,
        "words": pool.event_count,
    }


def hearing_costs() -> tuple[float, float]:
    """Seconds for handing out a lease and hearing its word, and for a wait when `PENDING` have nothing to say."""
    import ray

    from robogauntlet.orchestrator.episodes.lease import Lease
    from robogauntlet.orchestrator.episodes.policy_source import PolicySource
    from robogauntlet.orchestrator.ray_runtime.session import ray_session
    from robogauntlet.orchestrator.scheduling.ray_worker_pool import RayWorkerPool
    from robogauntlet.suites.episode import Cell, Protocol

    with ray_session(address=None, workers=1):
        pool = RayWorkerPool({"oracle": PolicySource("oracle")})
        cell = Cell("oracle", "oracle", "null/Reach", Protocol(20))
        worker = pool.start("null-0", "null", cell)
        for _ in range(2):
            pool.wait(60.0)
            worker.next_event()
        spent = 0.0
        for seed in range(WORDS):
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
    return spent / WORDS, waited
