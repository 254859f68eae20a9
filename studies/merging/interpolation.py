"""Interpolation between each expert and the base that it was fine-tuned from, whole or by part (arXiv 2512.08333).

`INTERPOLATED=FOLDER python -m studies merging --measure interpolation` (default `runs/interpolated`) writes the
networks and plays them: in their own task, clean and shifted, and in the eight others. What is finished in the folder
is kept, so that the same command continues.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet_mergevla.network.normalisation import TaskStatistics
from robogauntlet_mergevla.options import expert_folders
from robogauntlet_mergevla.zoo import shipped
from studies.merging.network_sums import BASE, Whole, interpolated, save
from studies.merging.operators import percent
from studies.percent import few, folder_of
from studies.shared import play_policies, table_of
from studies.tables import write_episodes

WAYS: dict[str, tuple[str, float, tuple[str, ...]]] = {
    "base": ("the base", 0.0, ()),
    "quarter": ("a quarter of the way", 0.25, ()),
    "half": ("half", 0.5, ()),
    "three-quarters": ("three quarters", 0.75, ()),
    "expert": ("the expert", 1.0, ()),
    "half-vision": ("half, vision alone", 0.5, ("vision", "projector")),
    "half-language": ("half, language model alone", 0.5, ("language",)),
    "half-trunk": ("half, action expert alone", 0.5, ("trunk",)),
}
"""Names, titles, share of the expert, and the parts that are interpolated (all without any)."""
ELSEWHERE = ("half", "three-quarters", "expert")
"""Those that are played in the tasks of the other experts, too; the base's own row is of all tasks."""
SHIFTED = yaml.safe_load(Path(__file__).with_name("registered_shifted.yaml").read_text(encoding="utf-8"))["conditions"]
FIRST, CLEAN_SEEDS, SHIFTED_SEEDS, OTHER_SEEDS = 30_000, 15, 3, 3
EPISODE = ("policy", "task", "seed", "axis", "status")
COLUMNS = {"network": "{title}", "own task": "{clean}", "own task, shifted": "{shifted}", "other tasks": "{others}"}


def measure() -> list[dict[str, object]]:
    """A row for each interpolation; writes the episodes beside the rows."""
    folder = folder_of("INTERPOLATED", "interpolated")
    base = Whole.read(shipped(BASE))
    folders = [*expert_folders(shipped("zoo:experts")).items()]
    experts = {task: Whole.read(path) for task, path in folders[: few(len(folders))]}
    for way, (_, share, only) in WAYS.items():
        for task, expert in experts.items():
            weights = interpolated(base.weights, expert.weights, share, only)
            its = base if share == 0 else expert
            own = TaskStatistics({task: its.metadata.statistics.of(task)})
            save(folder / way / task.replace("/", "__"), weights, expert.metadata, own)
            if way in ELSEWHERE:
                of_all = TaskStatistics({**base.metadata.statistics.by_task, **own.by_task})
                save(folder / f"{way}-elsewhere" / task.replace("/", "__"), weights, expert.metadata, of_all)
    every = {way: {"kind": "mergevla-experts", "options": {"folder": str(folder / way)}} for way in WAYS}
    clean = play_policies(folder, "clean", every, [*experts], CLEAN_SEEDS, EPISODE, first=FIRST)
    shifted = play_policies(folder, "shifted", every, [*experts], SHIFTED_SEEDS, EPISODE, SHIFTED, FIRST)
    frames = [clean, shifted[shifted.axis != "clean"]]
    for task in experts:
        name = task.replace("/", "__")
        policies: dict[str, dict[str, Any]] = {
            f"{way}-elsewhere": {"kind": "mergevla", "options": {"checkpoint": str(folder / f"{way}-elsewhere" / name)}}
            for way in ELSEWHERE
        }
        others = [other for other in experts if other != task]
        frames.append(play_policies(folder, f"of-{name}", policies, others, OTHER_SEEDS, EPISODE, first=FIRST))
    frame = pd.concat(frames)
    write_episodes("interpolation", frame, ("policy", "axis", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success with Wilson's interval: in the expert's own task, clean and shifted, and in the tasks of the others."""
    won = frame.assign(won=frame.status == "success")
    rows: list[dict[str, object]] = []
    for way, (title, *_) in WAYS.items():
        own, others = won[won.policy == way], won[won.policy == f"{way}-elsewhere"]
        parts = {"clean": own[own.axis == "clean"], "shifted": own[own.axis != "clean"], "others": others}
        rows.append({"way": way, "title": title, **{name: _rate(part.won) for name, part in parts.items()}})
    return rows


def _rate(won: pd.Series) -> str:
    return percent(won.mean(), wilson_interval(int(won.sum()), len(won))) if len(won) else ""
