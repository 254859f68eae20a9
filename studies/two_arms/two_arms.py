"""Experts of two arms merged beside experts of one, in a network of two arms.

`TWO_ARMS=FOLDER python -m studies two_arms --measure two_arms` (default `runs/two-arms`) merges and plays the experts
of `studies/two_arms/two_arms.sh`. What is finished in the folder is kept, so that the same command continues.
"""

from __future__ import annotations

import pandas as pd

from robogauntlet_mergevla.options import expert_folders
from studies.arms import arms
from studies.percent import folder_of
from studies.shared import merged_policy, play_policies, table_of
from studies.tables import write_episodes

TASKS = (
    *("robosuite/TwoArmLift@TwoPandas", "maniskill/TwoRobotPickCube-v1@TwoPandas"),
    *("robosuite/Lift", "maniskill/PushCube-v1"),
)
WAYS = ("none-4", "magnitude-2", "ties-s", "naive-mean")
ROUTED = ("magnitude-2-calibrated", "magnitude-2-self-trained")
SETTING = "two arms beside one"
SEEDS = 50


def measure() -> list[dict[str, object]]:
    """A row for each policy; writes the episodes beside the rows."""
    folder = folder_of("TWO_ARMS", "two-arms")
    found = expert_folders(folder / "experts")
    merges = arms.merges_of(folder, "all", {task: found[task] for task in TASKS}, WAYS)
    policies = {"experts": {"kind": "mergevla-experts", "options": {"folder": str(folder / "experts")}}}
    policies |= {way: merged_policy(out) for way, out in merges.items()}
    for name in ROUTED:
        way, router = arms.ROUTED[name]
        policies[name] = merged_policy(merges[way], router)
    frame = play_policies(folder, "two-arms", policies, TASKS, SEEDS, arms.EPISODE)
    write_episodes("two_arms", frame, ("policy", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, {name: field for name, field in arms.COLUMNS.items() if name != "setting"})
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """The rows of `arms.rows_of`; `frame` has a row per episode with the columns `arms.EPISODE`."""
    return arms.rows_of(frame.assign(setting=SETTING), {SETTING: TASKS})
