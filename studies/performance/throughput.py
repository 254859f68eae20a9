"""Episodes per second through the scheduler and Ray, and the driver's memory, with 100,000 empty episodes."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from studies.percent import few
from studies.shared import stored_rows, table_of

EPISODES = 100_000
SUITE = """
name: throughput
policies: [oracle, zero]
tasks: [null/Reach]
seeds: {{count: {episodes}}}
horizon: 20
workers: 2
"""
CODE = """
import resource, time
from robogauntlet.orchestrator.runs import run
from robogauntlet.orchestrator.cli import main

def peak(when):
    print(when, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024, time.process_time())

play = run.RunSession.play

def played(session):
    peak("planned:")
    play(session)
    peak("played:")

run.RunSession.play = played
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
finally:
    peak("reported:")
"""


def measure() -> list[dict[str, object]]:
    """Plan, play, store and report 100,000 episodes through the command line."""
    with tempfile.TemporaryDirectory() as folder:
        suite, run = Path(folder) / "suite.yaml", Path(folder) / "run"
        suite.write_text(SUITE.format(episodes=few(EPISODES) // 2), encoding="utf-8")
        start = time.perf_counter()
        command = [sys.executable, "-c", CODE, "run", str(suite), "--out", str(run), "--no-media"]
        done = subprocess.run(command, check=True, capture_output=True, text=True, env={**os.environ, "COLUMNS": "200"})
        whole = time.perf_counter() - start
        times = [row.started_at for row in stored_rows(run)]
    playing = max(times) - min(times)
    words = (line.split() for line in done.stdout.splitlines())
    printed = {line[0]: line[1:] for line in words if line and line[0] in ("planned:", "played:", "reported:")}
    computed_s = float(printed["played:"][1]) - float(printed["planned:"][1])
    rows: list[dict[str, object]] = [
        {
            "episodes": len(times),
            "per_second": len(times) / playing,
            "own_per_second": len(times) / computed_s,
            "whole_s": whole,
            "peak_mib": int(printed["played:"][0]),
            "peak_with_report_mib": int(printed["reported:"][0]),
        }
    ]
    columns = {"empty episodes": "{episodes:,}", "episodes a second, while played": "{per_second:,.0f}"}
    columns |= {"episodes a second of the scheduler's own time": "{own_per_second:,.0f}"}
    columns |= {"the whole run with its report, s": "{whole_s:.0f}", "the scheduler's memory, MiB": "{peak_mib}"}
    table_of(rows, columns | {"with the report, MiB": "{peak_with_report_mib}"})
    return rows
