"""Share of worker time spent in simulator or policy after start-up, during the demo suite with fewer seeds."""

import subprocess
import sys
import tempfile
from pathlib import Path

from results.report import read_tables
from tests.benchmarks.shared import table

SEEDS = 5


def measure() -> list[dict[str, object]]:
    """Run the demo suite (5 seeds) as a user does, and read the share from the run's own timings."""
    with tempfile.TemporaryDirectory() as folder:
        suite, run = Path(folder) / "demo.yaml", Path(folder) / "run"
        shipped = Path("suites/demo.yaml").read_text(encoding="utf-8")
        suite.write_text(shipped.replace("count: 20", f"count: {SEEDS}"), encoding="utf-8")
        command = [sys.executable, "-c", "from orchestrator.cli import main; main()"]
        subprocess.run([*command, "run", str(suite), "--out", str(run), "--no-media"], check=True, capture_output=True)
        timing = read_tables(run).timing
    found = [
        {
            "simulator": t.simulator,
            "episodes": t.episodes,
            "busy_share": t.busy_share,
            "wait_s": t.wait_s,
            "rest_s": t.rest_s,
        }
        for t in timing
    ]
    table(
        ("simulator", "episodes", "busy", "waiting, s", "rest, s"),
        [
            (f["simulator"], f["episodes"], f"{f['busy_share']:.3f}", f"{f['wait_s']:.2f}", f"{f['rest_s']:.2f}")
            for f in found
        ],
    )
    return found
