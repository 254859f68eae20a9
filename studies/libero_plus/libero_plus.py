"""LIBERO's experts and their merges under LIBERO-Plus, axis by axis, with and without the variant's name.

`LIBERO=FOLDER python -m studies libero_plus --measure libero_plus` (default `runs/libero`) plays the zoo's experts and
merged model, after `robogauntlet env create libero` and `libero-plus`. What is finished in the folder is kept, so that
the same command continues.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd

from robogauntlet.adapters.libero_plus.variants import PlusAxis, Variant, variants
from robogauntlet.results.statistics.rates import wilson_interval
from studies.libero.libero_experts import EXPERTS, SUITES, folder_of_experts, tasks_of
from studies.libero.libero_merges import MERGED, WAYS
from studies.merging.operators import kept_of, percent
from studies.percent import few
from studies.shared import merged_policy, play_policies, table_of
from studies.tables import write_episodes

AXES = (PlusAxis.CAMERA, PlusAxis.ROBOT, PlusAxis.LANGUAGE, PlusAxis.NOISE, PlusAxis.LAYOUT)
"""Those of which LIBERO's own assets show variants of every task."""
EACH = few(2, 1)
"""Variants of each axis and task: evenly spaced in LIBERO-Plus's order, from stored state 0, as it plays them."""
NAMED = "variant-name"
MERGES = {
    "magnitude-2-routed": merged_policy(MERGED, "calibrated"),
    "none-4": merged_policy(MERGED, recipe=WAYS["none-4"][1], experts=EXPERTS),
}
POLICIES = ("experts", *MERGES)
EPISODE = ("policy", "task", "seed", "axis", "status", "inferred_task")
COLUMNS = {
    "axis": "{plus_axis}",
    "experts": "{experts}",
    "two bits of magnitudes, routed": "{magnitude-2-routed}",
    "of the experts'": "{kept}",
    "routed right": "{routed}",
    "four bits each, not merged": "{none-4}",
    "of the experts', four bits": "{none-4-kept}",
    "experts told the variant's name": "{named}",
}


def measure() -> list[dict[str, object]]:
    """A row for each axis; writes the episodes beside the rows."""
    frame = pd.concat(_played(folder_of_experts()))
    write_episodes("libero_plus", frame, ("policy", "axis", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def _played(folder: Path) -> Iterator[pd.DataFrame]:
    chosen = {
        suite: [f"libero-plus/{one.task}" for axis in AXES for one in sampled(axis, tasks_of(suite), EACH)]
        for suite in SUITES
    }
    for suite, tasks in chosen.items():
        expert = {"experts": {"kind": "mergevla", "options": {"checkpoint": f"{EXPERTS}/libero-{suite}"}}}
        yield play_policies(folder, f"plus-experts-{suite}", expert, tasks, 1, EPISODE, ["clean", NAMED])
    every = [task for tasks in chosen.values() for task in tasks]
    for name, policy in MERGES.items():
        yield play_policies(folder, f"plus-{name}", {name: policy}, every, 1, EPISODE)


def sampled(axis: PlusAxis, tasks: Sequence[str], count: int) -> list[Variant]:
    """Return that many variants of each task, evenly spaced among those that LIBERO's own assets show."""
    found = []
    for task in tasks:
        shown = [
            one
            for one in variants()
            if one.axis is axis and f"libero/{one.base.task}" == task and not one.code.startswith("add")
        ]
        found += [shown[(2 * number + 1) * len(shown) // (2 * count)] for number in range(count)]
    return found


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success by axis with Wilson's interval. `frame` has a row per episode, with the columns `EPISODE`."""
    frame = frame.assign(
        won=frame.status.map({"success": 1.0, "failure": 0.0}),
        plus_axis=frame.task.str.partition("/")[2].str.partition("-")[0],
    )
    axes = [*(axis for axis in AXES if axis in set(frame.plus_axis)), "all"]
    return [_row(axis, frame if axis == "all" else frame[frame.plus_axis == axis]) for axis in axes]


def _row(axis: str, frame: pd.DataFrame) -> dict[str, object]:
    told = frame[frame.axis == "clean"].pivot(index=["task", "seed"], columns="policy", values="won")
    named = frame[(frame.axis == NAMED) & (frame.policy == "experts")].won.dropna()
    routed = frame[(frame.policy == "magnitude-2-routed") & frame.inferred_task.notna()]
    return {
        "plus_axis": axis,
        **{policy: _rate(told[policy].dropna()) for policy in POLICIES},
        "kept": kept_of(*told[["magnitude-2-routed", "experts"]].dropna().to_numpy().T),
        "none-4-kept": kept_of(*told[["none-4", "experts"]].dropna().to_numpy().T),
        "routed": f"{100 * (routed.inferred_task == routed.task).mean():.0f} %",
        "named": "" if axis == "all" else _rate(named),  # it has no episodes of `language`
    }


def _rate(won: pd.Series) -> str:
    return percent(won.mean(), wilson_interval(int(won.sum()), len(won))) if len(won) else ""
