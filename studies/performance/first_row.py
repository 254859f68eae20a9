"""From the command to the first row of a run by the oracle, beside an earlier installation and one process without Ray.

`EARLIER` is the command `robogauntlet` of the earlier one.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from studies.percent import few
from studies.shared import GAUNTLET, TASKS, table_of

TIMES = 3
EARLIER = os.environ.get("EARLIER")
ALONE = """
import sys
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.suites.episode import Cell, Protocol
runner = EpisodeRunner({"oracle": PolicySource("oracle", {})})
cell = Cell("oracle", "digest", sys.argv[1], Protocol(100))
runner.prepare(cell.task, cell.protocol.view)
print("seed 0:", runner.play_one(cell.episode(0)).status, flush=True)
"""
"""What a worker does, in one process."""


def measure() -> list[dict[str, object]]:
    """Medians of the times to the first row of each task (s), in new processes by turns."""
    commands = {"alone": [sys.executable, "-c", ALONE], "now": _run(GAUNTLET[0])}
    if EARLIER:
        commands["earlier"] = _run(EARLIER)
    waited: dict[tuple[str, str], list[float]] = {}
    for number in range(few(TIMES) + 1):
        for task in TASKS:
            for name, command in commands.items():
                taken = _first_row([part.replace("TASK", task) for part in command], task)
                if number:  # the first fills the disk's cache, and robosuite's of compiled code
                    waited.setdefault((task, name), []).append(taken)
    rows: list[dict[str, object]] = [
        {"task": task, **{name: median(waited[task, name]) for name in commands}} for task in TASKS
    ]
    columns = {"task": "`{task}`", "one process without Ray, s": "{alone:.1f}", "run, s": "{now:.1f}"}
    if EARLIER:
        rows = [{**row, "ratio": row["now"] / row["earlier"]} for row in rows]  # type: ignore[operator]
        columns |= {"an earlier run, s": "{earlier:.1f}", "ratio": "{ratio:.2f}"}
    table_of(rows, columns)
    return rows


def _run(program: str) -> list[str]:
    return [program, "run", "-v", "--policy", "oracle", "--task", "TASK", "--seeds", "3", "--out", "run"]


def _first_row(command: list[str], task: str) -> float:
    command = [*command, task] if command[0] == sys.executable else command
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        with subprocess.Popen(command, cwd=Path(folder), stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            lines = iter(process.stdout)
            before = next((line for line in lines if "seed " in line), None)
            taken = time.perf_counter() - start
            rest = [*lines]
        assert "success" in (before or ""), (before, rest)
    return taken
