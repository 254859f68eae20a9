"""LIBERO's four experts on the stored states, beside the controls: oracle, open loop, without images, without words.

`LIBERO=FOLDER python -m tests.benchmarks libero_experts` (default `runs/libero`) plays the experts of
`scripts/libero.sh`, after `robogauntlet env create libero`. What is finished in the folder is
kept, so that the same command continues.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from robogauntlet.policies.mergevla.options import expert_folders
from robogauntlet.results.statistics.rates import wilson_interval
from tests.benchmarks.document import write_episodes
from tests.benchmarks.operators import percent
from tests.benchmarks.shared import play_policies, table_of

SUITES = {"spatial": "Spatial", "object": "Object", "goal": "Goal", "10": "Long"}
STATES = 20
"""Stored states of each task, from the first on."""
EPISODE = ("policy", "task", "seed", "axis", "status")
TITLES = {
    ("oracle", "clean"): "oracle",
    ("experts", "clean"): "experts",
    ("replay", "clean"): "one demonstration, open loop",
    ("experts", "blind"): "experts, black images",
    ("experts", "blank-instruction"): "experts, no instruction",
    ("experts", "wrong-goal"): "experts, another task's instruction",
}
CONTROLS = [axis for policy, axis in TITLES if axis != "clean"]
COLUMNS = {"policy": "{title}", **{title: f"{{{suite}}}" for suite, title in SUITES.items()}, "all": "{all}"}


def measure() -> list[dict[str, object]]:
    """A row for each policy and control; writes the episodes beside the rows."""
    folder = folder_of_experts()
    experts, tasks = {"experts": experts_in(folder)}, tasks_of(folder)
    frames = []
    for suite in SUITES:
        own = [task for task in tasks if suite_of(task) == suite]
        shown = {"kind": "replay", "options": {"demonstrations": str(folder / "demonstrations" / suite)}}
        told = {**experts, "oracle": {"kind": "oracle"}, "replay": shown}
        controls = [axis for axis in CONTROLS if suite == "goal" or axis != "wrong-goal"]
        frames += [
            play_policies(folder, f"told-{suite}", told, own, STATES, EPISODE),
            play_policies(folder, f"controls-{suite}", experts, own, STATES, EPISODE, conditions=controls),
        ]
    frame = pd.concat(frames)
    write_episodes("libero_experts", frame, ("policy", "axis", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success by suite and in all with Wilson's interval. `frame` has a row per episode, with the columns `EPISODE`."""
    won = frame.assign(won=frame.status.map({"success": 1.0, "failure": 0.0}))
    rows = []
    for (policy, axis), title in TITLES.items():
        own = won[(won.policy == policy) & (won.axis == axis)].set_index(["task", "seed"]).won
        rows.append({"policy": policy, "axis": axis, "title": title, **by_suite(own)})
    return rows


def by_suite(won: pd.Series) -> dict[str, str]:
    """Success in each suite and in all, with Wilson's interval; empty where nothing was played.

    Args:
        won: 1.0 or 0.0, indexed by task and seed.
    """
    suites = won.index.get_level_values("task").map(suite_of)
    parts = {suite: won[suites == suite] for suite in SUITES}
    if all(map(len, parts.values())):
        parts["all"] = won
    return {"all": "", **{name: _rate(part) for name, part in parts.items()}}


def _rate(won: pd.Series) -> str:
    return percent(won.mean(), wilson_interval(int(won.sum()), len(won))) if len(won) else ""


def suite_of(task: str) -> str:
    """Part of LIBERO that a task is of: `goal` for `libero/goal-7-turn-on-stove`."""
    return task.partition("/")[2].partition("-")[0]


def folder_of_experts() -> Path:
    """The folder of `scripts/libero.sh`."""
    return Path(os.environ.get("LIBERO", "runs/libero")).absolute()


def experts_in(folder: Path) -> dict[str, Any]:
    """Kind and options of the experts for a suite."""
    return {"kind": "mergevla-experts", "options": {"folder": str(folder / "experts")}}


def tasks_of(folder: Path) -> Sequence[str]:
    """The tasks of the experts, suite by suite as in the literature."""
    return sorted(expert_folders(folder / "experts"), key=lambda task: (list(SUITES).index(suite_of(task)), task))
