"""Response times of the dashboard's pages (ms), with 10,000 runs of 27 cells in the store."""

from __future__ import annotations

import re
import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from studies.percent import few
from studies.shared import table_of
from tests.processes import GAUNTLET

RUNS, ROUNDS, DAY = few(10_000), few(21), 86_400.0
POLICIES, SUITES = ("experts", "merged", "merged-instruction-hidden"), ("nightly", "screening", "smoke")


def measure() -> list[dict[str, object]]:
    """Fill a store, serve it as users do, and request each page repeatedly."""
    import httpx2

    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        start = time.perf_counter()
        newest = _fill(root)
        print(f"{RUNS:,} runs stored in {time.perf_counter() - start:.0f} s", flush=True)
        command = [*GAUNTLET, "serve", "dashboard", "--port", "0", "--history", f"sqlite:///{root / 'history.sqlite'}"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=root)
        try:
            assert server.stdout is not None
            client = httpx2.Client(base_url=server.stdout.readline().split()[1], trust_env=False)
            rows = [_page(client, path) for path in _paths(newest)]
        finally:
            server.terminate()
            server.wait(30)
    columns = {
        "page": "`{name}`",
        "median, ms": "{median_ms:.0f}",
        "worst, ms": "{worst_ms:.0f}",
        "size, B": "{bytes:,}",
    }
    table_of(rows, columns)
    return rows


def _paths(newest: str) -> tuple[str, ...]:
    last = -(-RUNS // 50)
    return (
        *("/", "/api/live", "/runs", f"/runs?page={last // 2}", f"/runs?page={last}", "/runs?status=stopped"),
        *("/runs?suite=nightly&status=complete&policy=merged", f"/runs?policy=merged&page={last}", f"/runs/{newest}"),
        *("/history?policy=merged", "/history?policy=merged&suite=smoke&task=robosuite/Task2"),
        *("/leaderboard?suite=nightly", f"/compare?first={newest}", "/failures", "/schedule", "/metrics", "/healthz"),
    )


def _page(client: Any, path: str) -> dict[str, object]:
    times, size = [], 0
    for _ in range(ROUNDS):
        start = time.perf_counter()
        answer = client.get(path, timeout=120)
        times.append(1000 * (time.perf_counter() - start))
        size = len(answer.raise_for_status().content)
    name = re.sub(r"[0-9a-f]{32}", "ID", path)
    return {"name": name, "median_ms": statistics.median(times), "worst_ms": max(times), "bytes": size}


def _fill(root: Path) -> str:
    """Store runs of three policies and nine tasks in three suites; return the id of the newest, which has rows."""
    from robogauntlet.results.run_document import RunStatus
    from robogauntlet.results.store.database import file_url
    from robogauntlet.results.store.history_records import Counts
    from robogauntlet.results.store.run_history import History
    from tests.orchestrator.dashboard.filled import PROVENANCE, live_status
    from tests.results.synthetic import cells, document, row, run_folder

    tasks = tuple(f"{name}/Task{number}" for name in ("maniskill", "pybullet", "robosuite") for number in range(3))
    of = cells(POLICIES, tasks)
    history = History.open(file_url(root / "history.sqlite"))
    with history.database.engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA synchronous=OFF")
    packages = {f"package-{number}": "1.2.3" for number in range(40)}
    begun, run_id = time.time() - RUNS * 3600, ""
    for number in range(RUNS):
        run_id = f"{number:032x}"
        status = RunStatus.STOPPED if number % 97 == 5 else RunStatus.COMPLETE
        run = document(
            10,
            of=of,
            run_id=run_id,
            name=SUITES[number % 3],
            suite_text="# as long as a suite is\n" * 40,
            started_at=begun + 3600 * number,
            finished_at=begun + 3600 * number + 900,
            status=RunStatus.RUNNING if number == RUNS - 4 else status,
            provenance=PROVENANCE.model_copy(update={"packages": packages}),
        )
        counted = {(c.policy_digest, c.task, "clean", 0): Counts(10, 6 + (number + i) % 4, 3) for i, c in enumerate(of)}
        folder = root / f"{run.suite.name}-{number:05}"
        if number >= RUNS - 3:
            run_folder(
                folder, run, [row(c, seed, "failure" if seed > 6 else "success") for c in of for seed in range(10)]
            )
        history.record(run, folder, counted)
        if number % 2 and number > 3:
            history.write_verdict(
                run_id, "regressed" if number % 31 == 0 else "no evidence", f"{number - 3:032x}", ["a reason"]
            )
    history.write_live_status(f"{RUNS - 4:032x}", live_status(120))
    history.close()
    return run_id
