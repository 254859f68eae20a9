"""The same episodes of the same policy with one worker and with two, alternating."""

import subprocess
import sys
import tempfile
from pathlib import Path

from robogauntlet.results.run_document import read_run
from robogauntlet.results.store.episode_store import Store
from tests.benchmarks.shared import TASKS, table

EPISODES, ROUNDS = 24, 2
SUITE = """
name: workers
policies: [untrained]
tasks: [{task}]
seeds: {{count: {episodes}}}
horizon: 40
render_profile: fast
workers: {workers}
"""


def measure() -> list[dict[str, object]]:
    """Episodes per hour from the first to the last, the better of two rounds each."""
    rows = []
    for task in TASKS:
        best, hashes = {1: 0.0, 2: 0.0}, set()
        for _ in range(ROUNDS):
            for workers in best:
                pace, rows_hash = _run(task, workers)
                best[workers] = max(best[workers], pace)
                hashes.add(rows_hash)
        rows.append({"task": task, "one": best[1], "two": best[2], "same_rows": len(hashes) == 1})
    table(
        ("task", "one worker, episodes/h", "two workers", "ratio", "same rows"),
        [
            (f["task"], f"{f['one']:,.0f}", f"{f['two']:,.0f}", f"{f['two'] / f['one']:.2f}", f["same_rows"])
            for f in rows
        ],
    )
    return rows


def _run(task: str, workers: int) -> tuple[float, str | None]:
    """Episodes per hour of a run, and its rows hash."""
    with tempfile.TemporaryDirectory() as name:
        suite, folder = Path(name) / "suite.yaml", Path(name) / "run"
        suite.write_text(SUITE.format(task=task, episodes=EPISODES, workers=workers), encoding="utf-8")
        command = [sys.executable, "-c", "from robogauntlet.orchestrator.cli import main; main()", "run", str(suite)]
        subprocess.run([*command, "--out", str(folder), "--no-media"], check=True, capture_output=True)
        document = read_run(folder)
        store = Store.open_file(folder / "episodes.sqlite", document.run_id)
        rows = list(store.results())
        store.close()
    began = min(row.started_at for row in rows)
    ended = max(row.started_at + row.wall_s for row in rows)
    return 3600 * len(rows) / (ended - began), document.rows_hash
