"""Processor time of commands that start no simulator: what a user waits for before anything happens."""

import resource
import subprocess
import tempfile
import time
from pathlib import Path
from statistics import median

from robogauntlet.orchestrator.cli.common import EXIT_BAD_INPUT
from studies.percent import few
from studies.shared import GAUNTLET, table_of
from tests.processes import environment_of

TIMES = 5
MISTYPED = "run smok"
COMMANDS = ("--version", "plan --check smoke", "plan --check mergevla", "plan mergevla", MISTYPED)


def measure() -> list[dict[str, object]]:
    """Medians of processor time and time of each command, each in new processes by turns (s)."""
    spent: dict[str, list[float]] = {name: [] for name in COMMANDS}
    waited: dict[str, list[float]] = {name: [] for name in COMMANDS}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(few(TIMES) + 1):
            for name in COMMANDS:
                before, start = _children(), time.perf_counter()
                command = [*GAUNTLET, *name.split()]
                done = subprocess.run(command, capture_output=True, cwd=Path(folder), env=environment_of(), check=False)
                assert done.returncode == (EXIT_BAD_INPUT if name == MISTYPED else 0), done.stderr
                if number:  # the first fills the disk's cache
                    spent[name].append(_children() - before)
                    waited[name].append(time.perf_counter() - start)
    rows: list[dict[str, object]] = [
        {"command": name, "spent": median(spent[name]), "waited": median(waited[name])} for name in COMMANDS
    ]
    table_of(
        rows, {"command": "`robogauntlet {command}`", "processor time, s": "{spent:.2f}", "time, s": "{waited:.2f}"}
    )
    return rows


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
