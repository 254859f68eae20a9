"""LIBERO's experts kept apart, and merged, at equal precision: bits, bytes and success on the stored states.

`LIBERO=FOLDER python -m studies libero --measure libero_bits` (default `runs/libero`) merges and plays the zoo's
experts; what `libero_merges` has played is taken from its kept episodes. What is finished in the folder is kept.
"""

from __future__ import annotations

from typing import Any

import pandas as pd

from studies.libero.libero_experts import EXPERTS as ZOO, SUITES, by_suite, folder_of_experts, played, tasks_of
from studies.libero.libero_merges import EPISODE, EXPERTS, MERGED
from studies.merging.operators import kept_of, kilobytes_per_task
from studies.shared import merged_policy, table_of
from studies.tables import episodes_of, write_episodes

COPIES, SIGNS = {"operator": "none", "masks": "none"}, {"operator": "magnitude", "masks": "signs", "rounds": 2}
WAYS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "experts": ("copies, not merged", "own types", {}),
    "none-8": ("copies, not merged", "8", {**COPIES, "options": {"bits": 8}}),
    "none-4": ("copies, not merged", "4", {**COPIES, "options": {"bits": 4}}),
    "none-3": ("copies, not merged", "3", {**COPIES, "options": {"bits": 3}}),
    "magnitude-2-routed": ("two bits of magnitudes", "own types", SIGNS),
    "magnitude-2-4": ("two bits of magnitudes", "4", {**SIGNS, "bits": 4}),
    "ties-published-s": ("TIES+S, top 20 % as published", "own types", {"operator": "ties-published"}),
    "ties-published-s-4": ("TIES+S, top 20 % as published", "4", {"operator": "ties-published", "bits": 4}),
}
"""Names, titles, bits and recipes. Own types: 16 and 32-bit numbers."""
NEW, STATES = ("none-8", "none-3", "magnitude-2-4", "ties-published-s-4"), 10
"""Those that are played here, on the first stored states of each task; the others have twenty."""
COLUMNS = {
    "way": "{title}",
    "bits": "{bits}",
    "kB per expert": "{kilobytes:,.0f}",
    **{title: f"{{{title}}}" for title in SUITES.values()},
    "all": "{all}",
    "of the experts'": "{kept}",
}


def measure() -> list[dict[str, object]]:
    """A row for each way and number of bits; writes the episodes beside the rows."""
    folder = folder_of_experts()
    tasks = [task for suite in SUITES for task in tasks_of(suite)]
    frames = []
    for way in NEW:
        policy = merged_policy(MERGED, recipe=WAYS[way][2], experts=ZOO)
        frames.append(played(folder, way, {way: policy}, tasks, EPISODE, states=STATES))
    frame = pd.concat(frames)
    write_episodes("libero_bits", frame, ("policy", "task", "seed"))
    rows = rows_of(frame, {way: size_of(way) for way in WAYS})
    table_of(rows, COLUMNS)
    return rows


def size_of(way: str) -> float:
    """Storage of a way per expert beside the base (kB)."""
    kind = "mergevla-experts" if way == EXPERTS else "mergevla-merged"
    return kilobytes_per_task(kind, {"recipe": WAYS[way][2]}, experts=ZOO)


def counted(rows: list[dict[str, Any]]) -> list[dict[str, object]]:
    """The rows again, from the kept episodes; sizes are taken from the rows."""
    return rows_of(episodes_of("libero", "libero_bits"), {row["way"]: row["kilobytes"] for row in rows})


def rows_of(frame: pd.DataFrame, sizes: dict[str, float]) -> list[dict[str, object]]:
    """Success by suite, and its share of the experts' paired by state, with the score interval."""
    every = pd.concat([frame, episodes_of("libero", "libero_merges")])
    every = every[every.policy.isin(WAYS)]
    won = every.assign(won=every.status.map({"success": 1.0, "failure": 0.0}))
    table = won.pivot(index=["task", "seed"], columns="policy", values="won")
    rows = []
    for way, (title, bits, _) in WAYS.items():
        share = "" if way == EXPERTS else kept_of(*table[[way, EXPERTS]].dropna().to_numpy().T)
        row = {"way": way, "title": title, "bits": bits, "kilobytes": sizes[way], "kept": share}
        rows.append(row | by_suite(table[way]))
    return rows
