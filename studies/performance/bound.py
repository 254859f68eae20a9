"""How far an episode of the shipped experts is from its bound, in each simulator: `robogauntlet profile`."""

import json
import subprocess
from typing import Any

from studies.shared import GAUNTLET, table_of

PARTS = ("engine", "control", "frames", "answers", "rest", "total", "bound")
SUITE, TASKS, SEEDS = "mergevla", ("maniskill/PushCube-v1", "pybullet/PandaPush-v3", "robosuite/Lift"), 10


def measure() -> list[dict[str, Any]]:
    """CPU time per episode (ms)."""
    tasks = [word for task in TASKS for word in ("--task", task)]
    command = [*GAUNTLET, "profile", SUITE, "--policy", "experts", *tasks, "--seeds", str(SEEDS), "--json"]
    rows: list[dict[str, Any]] = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    columns = {"task": "{task}", "control steps": "{steps:.0f}"} | {f"{part}, ms": f"{{{part}:.0f}}" for part in PARTS}
    table_of(rows, columns | {"total / bound": "{ratio:.2f}"})
    return rows
