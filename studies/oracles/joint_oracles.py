"""Successes of the oracles of arms that are moved by the targets or velocities of their joints.

The run stays in `runs/bench/joint_oracles`, so that a second call plays what is missing.
"""

import pandas as pd

from robogauntlet.adapters import catalog
from studies.oracles.oracles import played
from studies.shared import table_of

SIMULATORS = ("robosuite", "gymnasium")
FIELDS = ("task", "seed", "status", "steps", "state_hash", "actions_hash", "policy_digest")
SUITE = """
name: joint-oracles
policies: [oracle]
tasks: {tasks}
seeds: {{start: 0, count: 100}}
image_size: 96
cameras: [third_person]
render_profile: fast
"""


def measure() -> list[dict[str, object]]:
    """Play seeds 0 to 99 of every task within its own horizon; nothing is rendered, as the oracles do not look."""
    rows = rows_of(played("joint_oracles", SUITE.format(tasks=list(tasks())), FIELDS))
    columns = {
        "task": "`{task}`",
        "horizon": "{horizon}",
        "oracle": "{successes} of {episodes}",
        "mean / most steps": "{mean_steps:.0f} / {most_steps}",
    }
    table_of(rows, columns)
    return rows


def tasks() -> dict[str, int]:
    """Return the tasks that are played by joints to their horizons."""
    found = [(f"{name}/{task}", told) for name in SIMULATORS for task, told in catalog.find(name).tasks.items()]
    return {task: description.horizon for task, description in found if description.joints}


def rows_of(episodes: pd.DataFrame) -> list[dict[str, object]]:
    """Return a row for each task."""
    rows: list[dict[str, object]] = []
    for task, horizon in tasks().items():
        its = episodes[episodes.task == task]
        steps = its.steps[its.status == "success"]
        counts = {"successes": len(steps), "episodes": len(its)}
        needed = {"mean_steps": float(steps.mean()), "most_steps": int(max(steps, default=0))}
        rows.append({"task": task, "horizon": horizon, **counts, **needed})
    return rows
