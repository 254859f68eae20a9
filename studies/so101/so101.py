"""Experts of the SO-101's tasks and their merges, in the colours that they were trained with and in others.

`SO101=FOLDER python -m studies so101 --measure so101` (default `runs/so101`) merges and plays the experts of
`studies/so101/so101.sh`. What is finished in the folder is kept, so that the same command continues.
"""

from __future__ import annotations

import pandas as pd

from robogauntlet.adapters.so101.tasks import OTHER_COLOURS
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet_mergevla.options import expert_folders
from studies.arms import arms
from studies.merging.operators import percent
from studies.percent import folder_of
from studies.shared import merged_policy, play_policies, table_of
from studies.tables import write_episodes

TASKS = ("so101/PickPlace", "so101/Push", "so101/Stack")
SETTINGS = {"trained colours": TASKS, "other colours": tuple(f"{task}{OTHER_COLOURS}" for task in TASKS)}
WAYS = ("none-4", "magnitude-2", "ties-s", "naive-mean")
ROUTED = ("magnitude-2-calibrated", "magnitude-2-self-trained")
ORACLE_SEEDS = 100
SEEDS = 20
"""As many as the rollouts of MergeVLA's fourth table (arXiv 2511.18810)."""


def measure() -> list[dict[str, object]]:
    """A row for each setting and policy; writes the episodes beside the rows."""
    folder = folder_of("SO101", "so101")
    merges = arms.merges_of(folder, "all", expert_folders(folder / "experts"), WAYS)
    policies = {"experts": {"kind": "mergevla-experts", "options": {"folder": str(folder / "experts")}}}
    policies |= {way: merged_policy(out) for way, out in merges.items()}
    for name in ROUTED:
        way, router = arms.ROUTED[name]
        policies[name] = merged_policy(merges[way], router)
    tasks = [task for setting in SETTINGS.values() for task in setting]
    oracle = play_policies(folder, "oracle", {"oracle": {"kind": "oracle"}}, tasks, ORACLE_SEEDS, arms.EPISODE)
    frame = pd.concat([oracle, play_policies(folder, "so101", policies, tasks, SEEDS, arms.EPISODE)])
    write_episodes("so101", frame, ("policy", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, arms.COLUMNS)
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """The oracle's row of each setting, then those of `arms.rows_of`; `frame` has the columns `arms.EPISODE`."""
    setting = {task: name for name, tasks in SETTINGS.items() for task in tasks}
    frame = frame.assign(setting=frame.task.map(setting))
    rows = arms.rows_of(frame[frame.policy != "oracle"], SETTINGS)
    return [_oracle(name, frame[(frame.policy == "oracle") & (frame.setting == name)]) for name in SETTINGS] + rows


def _oracle(setting: str, episodes: pd.DataFrame) -> dict[str, object]:
    won = episodes.status == "success"
    interval = wilson_interval(int(won.sum()), len(won))
    assert interval is not None
    return {
        "setting": setting,
        "policy": "oracle",
        "title": f"oracle, {ORACLE_SEEDS} seeds",
        "tasks": " / ".join(f"{100 * won[episodes.task == task].mean():.0f}" for task in SETTINGS[setting]),
        "success": percent(float(won.mean()), interval),
        "kept": "",
        "chosen": "",
    }
