"""Successes of the oracles of Meta-World, gymnasium and the SO-101, and the steps that they need.

The run stays in `runs/bench/further_oracles`, so that a second call plays what is missing.
"""

from __future__ import annotations

import pandas as pd

from robogauntlet.adapters import catalog
from studies.oracles.oracles import played
from studies.shared import table_of

SIMULATORS = ("metaworld", "gymnasium", "so101")
FIELDS = ("task", "seed", "status", "steps")
SUITE = """
name: further-oracles
policies: [oracle]
tasks: ["metaworld/*", "gymnasium/Fetch*", "gymnasium/Panda*", "so101/*"]
seeds: {start: 0, count: 20}
cameras: [third_person]
"""
COLUMNS = {"task": "{task}", "horizon": "{horizon}", "oracle": "{oracle}", "mean / most steps": "{steps}"}


def measure() -> list[dict[str, object]]:
    """Play seeds 0 to 19 of every task within its own horizon; nothing is rendered, as the oracles do not look."""
    episodes = played("further_oracles", SUITE, FIELDS)
    rows = rows_of(episodes)
    table_of(rows, COLUMNS)
    return rows


def rows_of(episodes: pd.DataFrame) -> list[dict[str, object]]:
    """A row for all tasks of each simulator, and one for each task in which not every episode succeeds."""
    rows: list[dict[str, object]] = []
    for name in SIMULATORS:
        own = {f"{name}/{task}": told.horizon for task, told in catalog.find(name).tasks.items()}
        every = episodes[episodes.task.isin(own)]
        rows.append(_row(f"all {every.task.nunique()} of {catalog.find(name).title}", "", every))
        for task, horizon in own.items():
            its = every[every.task == task]
            if (its.status != "success").any():
                rows.append(_row(f"`{task}`", str(horizon), its))
    return rows


def _row(task: str, horizon: str, episodes: pd.DataFrame) -> dict[str, object]:
    steps = episodes.steps[episodes.status == "success"]
    needed = f"{steps.mean():.0f} / {steps.max()}"
    return {"task": task, "horizon": horizon, "oracle": f"{len(steps)} of {len(episodes)}", "steps": needed}
