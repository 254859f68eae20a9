"""Success of LIBERO's small experts from stored states, and from placements that are drawn anew.

`LIBERO=FOLDER python -m studies libero --measure libero_resampled` (default `runs/libero`) plays the shipped experts
clean, and under the control `resampled`.
"""

from __future__ import annotations

from typing import Any

import pandas as pd

from robogauntlet.results.statistics.rates import rate_difference
from studies.libero.libero_experts import EPISODE, SUITES, by_suite, folder_of_experts, played, suite_of, tasks_of
from studies.shared import table_of
from studies.tables import write_episodes

EXPERTS, STATES = "zoo:libero-experts", 10
COLUMNS = {"starts": "{title}", **{title: f"{{{title}}}" for title in (*SUITES.values(), "all")}}


def measure() -> list[dict[str, object]]:
    """Rows of stored and drawn starts, and of the difference; writes the episodes beside the rows."""
    policy = {"experts": {"kind": "mergevla-experts", "options": {"folder": EXPERTS}}}
    tasks = [task for suite in SUITES for task in tasks_of(suite)]
    frame = played(folder_of_experts(), "resampled", policy, tasks, EPISODE, ["clean", "resampled"], STATES)
    write_episodes("libero_resampled", frame, ("axis", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success by suite with Wilson's interval, and the difference with Newcombe's for separate trials, in points."""
    every = frame.assign(won=frame.status.map({"success": 1.0, "failure": 0.0}))
    sides = [every[every.axis == axis] for axis in ("clean", "resampled")]
    titles = ("stored states", "placed anew")
    rows: list[dict[str, Any]] = [
        {"title": title, **by_suite(side.set_index(["task", "seed"]).won)}
        for title, side in zip(titles, sides, strict=True)
    ]
    suites = [side.task.map(suite_of) for side in sides]
    lost = {}
    for suite, title in (*SUITES.items(), ("", "all")):
        parts = [side[places == suite] if suite else side for side, places in zip(sides, suites, strict=True)]
        first, second = ((int(part.won.sum()), int(part.won.notna().sum())) for part in parts)
        found = rate_difference(first, second)
        if found is not None and found.interval is not None:
            low, high = (round(100 * end) for end in (found.interval.low, found.interval.high))
            lost[title] = f"{round(100 * found.value):+d} [{low}, {high}]"
    return [*rows, {"title": "lost (points)", **lost}]
