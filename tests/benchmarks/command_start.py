"""Processor time of commands that start no simulator: what a user waits for before anything happens."""

import resource
import subprocess
import tempfile
import time
from pathlib import Path
from statistics import median

from tests.benchmarks.shared import table_of
from tests.processes import GAUNTLET, environment_of

TIMES = 5
COMMANDS = {
    "robogauntlet --version": ["--version"],
    "robogauntlet validate smoke": ["validate", "smoke"],
    "robogauntlet validate mergevla": ["validate", "mergevla"],
    "robogauntlet plan mergevla": ["plan", "mergevla"],
    "robogauntlet run smok (mistyped)": ["run", "smok"],
}


def measure() -> list[dict[str, object]]:
    """Medians of processor time and time of each command, each in new processes by turns (s)."""
    spent: dict[str, list[float]] = {name: [] for name in COMMANDS}
    waited: dict[str, list[float]] = {name: [] for name in COMMANDS}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(TIMES + 1):
            for name, words in COMMANDS.items():
                before, start = _children(), time.perf_counter()
                subprocess.run([*GAUNTLET, *words], capture_output=True, cwd=Path(folder), env=environment_of())
                if number:  # the first fills the disk's cache
                    spent[name].append(_children() - before)
                    waited[name].append(time.perf_counter() - start)
    rows: list[dict[str, object]] = [
        {"command": name, "spent": median(spent[name]), "waited": median(waited[name])} for name in COMMANDS
    ]
    table_of(rows, {"command": "`{command}`", "processor time, s": "{spent:.2f}", "time, s": "{waited:.2f}"})
    return rows


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
