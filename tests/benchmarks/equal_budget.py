"""Three experts of varied scenes with as many demonstrations and steps as the zoo's, beside these under all axes.

`ROBUST=FOLDER python -m tests.benchmarks equal_budget` reads the run `equal-budget` of `scripts/robust_experts.sh`.
"""

from __future__ import annotations

from itertools import product

import pandas as pd

from robogauntlet.suites.episode import CLEAN
from tests.benchmarks.document import write_episodes
from tests.benchmarks.robust_experts import COLUMNS, EPISODE, TRAINED_ON, compared, episodes_of
from tests.benchmarks.shared import table_of


def measure() -> list[dict[str, object]]:
    """A row for each task, and all together, in each group of conditions; writes the episodes beside the rows."""
    frame = episodes_of("equal-budget")
    write_episodes("equal_budget", frame, EPISODE[:5])
    rows = rows_of(frame)
    table_of(rows, {"task": "{task}"} | COLUMNS)
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success of both experts and their difference; `frame` has the columns `EPISODE`, and the families as policies."""
    axes = [axis for axis in frame.axis.unique() if axis != CLEAN]
    groups = {CLEAN: [CLEAN], f"all {len(axes)} axes": axes, f"{len(TRAINED_ON)} axes of the scenes": TRAINED_ON}
    tasks = {task.partition("/")[2]: [task] for task in sorted(frame.task.unique())}
    tasks |= {f"all {len(tasks)}": list(frame.task.unique())}
    return [
        {"task": task, "name": name} | compared(frame[frame.task.isin(of_task) & frame.axis.isin(chosen)])
        for (task, of_task), (name, chosen) in product(tasks.items(), groups.items())
    ]
