"""Success of the experts where they are asked before their last answer is used up, so that two answers can be blended.

`LATENCY=FOLDER python -m studies latency --measure asking_early` (default `runs/latency`) plays the zoo's nine tasks
again with `replan_every: 2`. What is finished is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from robogauntlet.suites.axes import AXES
from studies.latency.latency import EPISODE, MODES, POLICIES, SEEDS, TASKS, row_of
from studies.percent import folder_of
from studies.shared import play_policies, table_of
from studies.tables import episodes_of, write_episodes

EXPERTS, REPLAN_EVERY = "experts", 2
LEVELS = (1, 2, 3)
"""Those at which an answer of four actions is longer than the wait, or just as long."""
COLUMNS = {
    "robot": "{mode}",
    "0 ms": "{rate_0}",
    **{f"{AXES['latency'].value(level):g} ms": f"{{rate_{level}}}" for level in LEVELS},
    "lost at 100 ms": "{lost}",
    "steps held at 100 ms": "{held}",
}


def measure() -> list[dict[str, Any]]:
    """A row for each mode; writes the episodes beside the rows."""
    conditions = ("clean", *(f"{axis}@{','.join(map(str, LEVELS))}" for axis in MODES))
    policies = {EXPERTS: POLICIES[EXPERTS]}
    folder = folder_of("LATENCY", "latency")
    frame = play_policies(
        folder, "asking-early", policies, TASKS, SEEDS, EPISODE, conditions, replan_every=REPLAN_EVERY
    )
    write_episodes("asking_early", frame, ("policy", "task", "axis", "severity", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, from the kept episodes."""
    return rows_of(episodes_of("latency", "asking_early"))


def rows_of(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Success by latency for each mode, as in `latency`."""
    frame = frame.assign(won=frame["status"].map({"success": 1.0, "failure": 0.0}))
    return [row_of(frame, EXPERTS, "all", axis, LEVELS) for axis in MODES]
