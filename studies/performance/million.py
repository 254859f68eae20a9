"""A report over 1,000,000 stored episodes: seconds and memory from the store to the written files."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from studies.percent import few
from studies.shared import table_of

EPISODES = few(1_000_000)
CODE = """
import resource, sys, time
from pathlib import Path
from robogauntlet.results.report import write_report
start = time.perf_counter()
write_report(Path(sys.argv[1]))
print(time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
"""Prints the seconds and MiB of a report in its own process."""


def measure() -> list[dict[str, object]]:
    """Fill a store, then write its report as `robogauntlet report` does."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        start = time.perf_counter()
        episodes = _fill(run)
        filled = time.perf_counter() - start
        done = subprocess.run([sys.executable, "-c", CODE, str(run)], check=True, stdout=subprocess.PIPE, text=True)
        seconds, memory = map(float, done.stdout.split())
    rows: list[dict[str, object]] = [{"episodes": episodes, "store_s": filled, "report_s": seconds, "memory": memory}]
    columns = {"episodes": "{episodes:,}", "storing them, s": "{store_s:.0f}", "their report, s": "{report_s:.0f}"}
    table_of(rows, columns | {"memory, MiB": "{memory:,.0f}"})
    return rows


def _fill(folder: Path) -> int:
    """A run of four policies, nine tasks and all axes at two severities, with a gate, a comparison and routing."""
    import numpy as np

    from robogauntlet.results.run_document import store_url, write_run
    from robogauntlet.results.store.episode_store import Store
    from robogauntlet.suites.axes import AXES
    from robogauntlet.suites.episode import CONTROLS, Condition
    from robogauntlet.suites.schema import CompareEntry
    from tests.results.synthetic import cells, document, row

    simulators = ("maniskill", "pybullet", "robosuite")
    tasks = tuple(f"{name}/Task{number}" for name in simulators for number in range(3))
    axes = [name for name, axis in AXES.items() if name not in CONTROLS]
    conditions: tuple[Condition, ...] = (Condition(), Condition("blind", 1), Condition("again", 1))
    conditions += tuple(Condition(name, severity) for name in axes for severity in (2, 4))
    plan = cells(("oracle", "experts", "merged-oracle-routed", "merged"), tasks, conditions)
    seeds = -(-EPISODES // len(plan))
    run = document(
        seeds,
        of=plan,
        oracle_gate="oracle",
        compare=CompareEntry(baseline="experts", others=("merged-oracle-routed", "merged")),
    )
    folder.mkdir()
    write_run(folder, run)
    store, generator = Store.open(store_url(folder, run), run.run_id), np.random.default_rng(0)
    for cell in plan:
        rate = 1.0 if cell.policy == "oracle" else 0.9 - 0.1 * cell.condition.severity
        won = generator.random(seeds) < rate
        routed = {"inferred_task": cell.task} if cell.policy == "merged" else {}
        store.add([row(cell, n, "success" if won[n] else "failure", delivered=1.0, **routed) for n in range(seeds)])
    store.close()
    return seeds * len(plan)
