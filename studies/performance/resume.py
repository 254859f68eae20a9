"""Time until the first new episode of a continued run that has almost 1,000,000 rows."""

import signal
import sqlite3
import subprocess
import tempfile
import time
from pathlib import Path

from studies.percent import few
from studies.shared import GAUNTLET, table_of

PLANNED, MISSING = few(1_000_000), 100
SUITE = f"""
name: resume
policies: [oracle, zero]
tasks: [null/Reach]
seeds: {{count: {PLANNED // 2}}}
horizon: 20
"""
TIME_LIMIT_S = 300.0


def measure() -> list[dict[str, object]]:
    """Begin a run, fill its store except for a few episodes, and continue it until it has a new row."""
    with tempfile.TemporaryDirectory() as name:
        suite, folder = Path(name) / "suite.yaml", Path(name) / "run"
        suite.write_text(SUITE, encoding="utf-8")
        begun = _first_episode_s(suite, folder)
        _fill(suite, folder)
        continued = _first_episode_s(suite, folder)
    rows: list[dict[str, object]] = [{"rows": PLANNED - MISSING, "new_run_s": begun, "continued_s": continued}]
    columns = {"stored rows": "{rows:,}", "a new run's first episode, s": "{new_run_s:.1f}"}
    table_of(rows, columns | {"the continued run's first new episode, s": "{continued_s:.1f}"})
    return rows


def _first_episode_s(suite: Path, folder: Path) -> float:
    """Time from the start of `robogauntlet run` to that of its first episode (s); then the run is interrupted."""
    start = time.time()
    process = subprocess.Popen(
        [*GAUNTLET, "run", str(suite), "--out", str(folder), "--no-media"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        while not (began := _starts(folder, since=start)):
            if time.time() - start > TIME_LIMIT_S or process.poll() is not None:
                raise RuntimeError("the run did not begin")
            time.sleep(0.5)
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()
    return min(began) - start


def _starts(folder: Path, since: float) -> list[float]:
    """Start times of the episodes of this session."""
    try:
        connection = sqlite3.connect(f"file:{folder / 'episodes.sqlite'}?mode=ro", uri=True)
    except sqlite3.OperationalError:
        return []
    try:
        newest = "SELECT started_at FROM episodes ORDER BY rowid DESC LIMIT 1000"
        return [moment for (moment,) in connection.execute(newest) if moment >= since]
    except sqlite3.OperationalError:
        return []  # it is being created
    finally:
        connection.close()


def _fill(suite: Path, folder: Path) -> None:
    from robogauntlet.orchestrator.runs.plan import make_plan
    from robogauntlet.results.run_document import read_run
    from robogauntlet.results.store.episode_store import Store
    from tests.results.synthetic import row

    store = Store.open_file(folder / "episodes.sqlite", read_run(folder).run_id)
    plan = make_plan(suite)
    for cell in plan.cells:
        seeds = list(plan.suite.seeds)[: -MISSING // len(plan.cells)]
        for first in range(0, len(seeds), 10_000):
            store.add([row(cell, seed, started_at=0.0) for seed in seeds[first : first + 10_000]])
    store.close()
