"""Experts of several arms kept apart, and merged, at equal precision: bits, bytes and success.

`ARMS=FOLDER python -m studies arms --measure arms_bits` (default `runs/arms`) merges and plays experts of
`studies/arms/arms.sh` and two of the zoo, as `arms` does. What is finished in the folder is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from robogauntlet_mergevla.options import expert_folders
from robogauntlet_mergevla.zoo import shipped
from studies.arms.arms import ONE_SKILL, THREE_SKILLS
from studies.merging import bits
from studies.percent import folder_of
from studies.shared import play_policies, table_of
from studies.tables import episodes_of, write_episodes

SETTINGS = {"one skill": ONE_SKILL, "three skills": THREE_SKILLS}
SEEDS = 25
EPISODE = ("policy", "task", "seed", "status")
COLUMNS = {"setting": "{setting}", **bits.COLUMNS}


def measure() -> list[dict[str, Any]]:
    """A row for each setting and way; writes the episodes beside the rows."""
    folder = folder_of("ARMS", "arms")
    experts = {**expert_folders(shipped("zoo:experts")), **expert_folders(folder / "experts")}
    frames, sizes = [], {}
    for setting, tasks in SETTINGS.items():
        name = f"bits-{setting.replace(' ', '-')}"
        policies, sizes[setting] = bits.policies_of(folder / "merges" / name, [experts[task] for task in tasks])
        own = [
            play_policies(
                folder,
                f"{name}-{task.replace('/', '-').replace('@', '-')}",
                {bits.EXPERTS: {"kind": "mergevla", "options": {"checkpoint": str(experts[task])}}},
                [task],
                SEEDS,
                EPISODE,
            )
            for task in tasks
        ]
        merged = play_policies(folder, name, policies, tasks, SEEDS, EPISODE)
        frames += [frame.assign(setting=setting) for frame in (*own, merged)]
    frame = pd.concat(frames)
    write_episodes("arms_bits", frame, ("setting", "policy", "task", "seed"))
    rows = rows_of(frame, sizes)
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, from the kept episodes; sizes are taken from the rows."""
    sizes = {setting: bits.sizes_in([row for row in rows if row["setting"] == setting]) for setting in SETTINGS}
    return rows_of(episodes_of("arms", "arms_bits"), sizes)


def rows_of(frame: pd.DataFrame, sizes: Mapping[str, Mapping[str, float]]) -> list[dict[str, Any]]:
    """A row for each setting and way; the frame has the columns `EPISODE` and the setting."""
    return [
        {"setting": setting, **row}
        for setting in SETTINGS
        for row in bits.rows_of(frame[frame["setting"] == setting], sizes[setting])
    ]
