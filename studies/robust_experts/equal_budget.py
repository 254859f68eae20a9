"""Three experts of varied scenes beside plain ones with as many demonstrations and steps, under all axes.

`ROBUST=FOLDER python -m studies robust_experts --measure equal_budget` reads the run `equal-budget` of
`studies/robust_experts/robust_experts.sh`.
"""

from __future__ import annotations

from itertools import product

import pandas as pd

from studies.robust_experts.robust_experts import EPISODE, columns_of, compared, episodes_of, groups_of
from studies.shared import table_of
from studies.tables import write_episodes

TOGETHER = "all three"
FAMILIES = ("plain", "robust")


def measure() -> list[dict[str, object]]:
    """A row for each task, and all together, in each group of conditions; writes the episodes beside the rows."""
    frame = episodes_of("equal-budget")
    write_episodes("equal_budget", frame, EPISODE[:5])
    rows = rows_of(frame)
    table_of(rows, {"task": "{task}"} | columns_of("plain", "plain"))
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success of both experts and their difference; `frame` has the columns `EPISODE`, and the families as policies."""
    tasks = {task.partition("/")[2]: [task] for task in sorted(frame.task.unique())}
    tasks |= {TOGETHER: list(frame.task.unique())}
    return [
        {"task": task, "name": name} | compared(frame[frame.task.isin(of_task) & frame.axis.isin(chosen)], FAMILIES)
        for (task, of_task), (name, chosen) in product(tasks.items(), groups_of(frame).items())
    ]
