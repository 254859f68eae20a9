"""MergeVLA's Table 1 at a small size: the four experts of LIBERO merged, on the stored states, the paper's rows beside.

`LIBERO=FOLDER python -m studies libero --measure libero_merges` (default `runs/libero`) merges and plays the zoo's
experts. What is finished in the folder is kept, so that the same command continues.
"""

from __future__ import annotations

from typing import Any

import pandas as pd

from studies.libero.libero_experts import (
    EXPERTS as ZOO,
    SUITES,
    by_suite,
    folder_of_experts,
    played,
    played_experts,
    suite_of,
    tasks_of,
)
from studies.merging.operators import kept_of
from studies.shared import merged_policy, table_of
from studies.tables import write_episodes

MERGED = "zoo:libero-merged"
"""Two bits of magnitudes, and the routers of all ways."""
EXPERTS = "experts"
OPERATORS = {"ta": "TA", "ties": "TIES", "tsv": "TSV", "knots": "KnOTS", "wudi": "WUDI"}
"""Those that are played without masks, to their titles."""
WAYS: dict[str, tuple[str, dict[str, Any]]] = {
    "none-4": ("four bits each, not merged", {"operator": "none", "masks": "none", "options": {"bits": 4}}),
    "emr": ("EMR", {"operator": "emr"}),
    "ties-s": ("TIES+S", {"operator": "ties"}),
    "knots-s": ("KnOTS+S", {"operator": "knots"}),
    "ta-s": ("TA+S", {"operator": "ta"}),
    "wudi-s": ("WUDI+S", {"operator": "wudi"}),
    "tsv-s": ("TSV+S", {"operator": "tsv"}),
    "ties-published-s": ("TIES+S, top 20 % as published", {"operator": "ties-published"}),
    "ties-s-averaged-trunk": ("TIES+S, averaged trunk", {"operator": "ties", "trunk": "mean"}),
    "ta-s-averaged-trunk": ("TA+S, averaged trunk", {"operator": "ta", "trunk": "mean"}),
    "tsv-s-averaged-trunk": ("TSV+S, averaged trunk", {"operator": "tsv", "trunk": "mean"}),
    "mean": ("mean, no masks", {"operator": "mean", "masks": "none"}),
    **{name: (f"{title}, no masks", {"operator": name, "masks": "none"}) for name, title in OPERATORS.items()},
}
"""Names, titles and recipes. All keep the deepest block and the output layer of each expert's action expert."""
UNMASKED_STATES = 10
"""Stored states for merges without masks, which are fewer, since none succeeds on any of these."""
ROUTED: dict[str, tuple[str, dict[str, Any]]] = {
    "magnitude-2-routed": ("two bits of magnitudes, routed", {}),
    "magnitude-2-routed-instruction-hidden": (
        "two bits of magnitudes, routed without the instruction",
        {"sees_instruction": False},
    ),
}
"""Merges whose calibrated router decides once per episode: names, titles and options."""
PAPER = {
    EXPERTS: "98 / 99 / 95 / 95",
    "ties-s-averaged-trunk": "95 / 95 / 92 / 79",
    "ta-s-averaged-trunk": "98 / 99 / 85 / 77",
    "tsv-s-averaged-trunk": "99 / 98 / 74 / 55",
}
"""Success in MergeVLA's Table 1 (arXiv 2511.18810), Spatial / Object / Goal / Long, %."""
EPISODE = ("policy", "task", "seed", "axis", "status", "inferred_task")
COLUMNS = {
    "way": "{title}",
    **{title: f"{{{title}}}" for title in SUITES.values()},
    "all": "{all}",
    "of the experts'": "{kept}",
    "routed right": "{routed}",
    "in the paper": "{paper}",
}


def measure() -> list[dict[str, object]]:
    """A row for each way of merging and router; writes the episodes beside the rows."""
    folder = folder_of_experts()
    tasks = [task for suite in SUITES for task in tasks_of(suite)]
    policies = {way: merged_policy(MERGED, recipe=recipe, experts=ZOO) for way, (_, recipe) in WAYS.items()}
    policies |= {name: merged_policy(MERGED, "calibrated", **options) for name, (_, options) in ROUTED.items()}
    unmasked = {name: policies.pop(name) for name in ("mean", *OPERATORS)}
    frames = [clean[clean.axis == "clean"] for clean in played_experts(folder)]
    frames.append(played(folder, "merges", policies, tasks, EPISODE))
    frames.append(played(folder, "merges without masks", unmasked, tasks, EPISODE, states=UNMASKED_STATES))
    frame = pd.concat(frames)
    write_episodes("libero_merges", frame, ("policy", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success by suite with Wilson's interval, its share of the experts' paired by state, and the router's decisions.

    `frame` has a row per episode, with the columns `EPISODE`.
    """
    won = frame.assign(won=frame.status.map({"success": 1.0, "failure": 0.0})).pivot(
        index=["task", "seed"], columns="policy", values="won"
    )
    titles = {EXPERTS: "experts", **{name: title for name, (title, _) in (ROUTED | WAYS).items()}}
    return [
        {
            "policy": policy,
            "title": title,
            **by_suite(won[policy]),
            "kept": "" if policy == EXPERTS else kept_of(*won[[policy, EXPERTS]].to_numpy().T),
            "routed": _routed(frame[frame.policy == policy]) if policy in ROUTED else "",
            "paper": PAPER.get(policy, ""),
        }
        for policy, title in titles.items()
        if policy in won
    ]


def _routed(episodes: pd.DataFrame) -> str:
    """The share of episodes in which the expert of the suite was chosen, suite by suite."""
    right = (episodes.inferred_task == episodes.task).groupby(episodes.task.map(suite_of)).mean()
    return " / ".join(f"{100 * right[suite]:.0f}" for suite in SUITES) + " %"
