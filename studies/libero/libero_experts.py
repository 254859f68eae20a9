"""LIBERO's four experts on the stored states, beside the controls: oracle, open loop, without images, without words.

`LIBERO=FOLDER python -m studies libero --measure libero_experts` (default `runs/libero`) plays the zoo's experts, and
the replays of `studies/libero/libero.sh FOLDER`, after `robogauntlet env create libero`. What is finished in the folder
is kept, so that the same command continues.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
from robogauntlet_mergevla.zoo import shipped
from studies.merging.operators import percent
from studies.percent import few, folder_of
from studies.shared import play_policies, table_of
from studies.tables import write_episodes

EXPERTS = "zoo:libero-experts"
SUITES = {"spatial": "Spatial", "object": "Object", "goal": "Goal", "10": "Long"}
STATES = 20
"""Stored states of each task, from the first on."""
RUN_STATES = 10
"""States in one run: what was played stays valid when `STATES` grows."""
EPISODE = ("policy", "task", "seed", "axis", "status")
TITLES = {
    ("oracle", "clean"): "oracle",
    ("experts", "clean"): "experts",
    ("replay", "clean"): "one demonstration, open loop",
    ("random-base", "clean"): "expert on a base of random weights",
    ("experts", "blind"): "experts, black images",
    ("experts", "blank-instruction"): "experts, no instruction",
    ("experts", "wrong-goal"): "experts, another task's instruction",
}
CONTROLS = [axis for policy, axis in TITLES if axis != "clean"]
COLUMNS = {"policy": "{title}", **{title: f"{{{title}}}" for title in SUITES.values()}, "all": "{all}"}


def measure() -> list[dict[str, object]]:
    """A row for each policy and control; writes the episodes beside the rows."""
    folder = folder_of_experts()
    frame = pd.concat([*played_experts(folder), *played_baselines(folder), played_control(folder)])
    write_episodes("libero_experts", frame, ("policy", "axis", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def played_experts(folder: Path) -> Iterator[pd.DataFrame]:
    """Play the experts, clean and with the controls, suite by suite: a row per episode."""
    for suite in SUITES:
        experts = {"experts": {"kind": "mergevla", "options": {"checkpoint": f"{EXPERTS}/libero-{suite}"}}}
        conditions = ["clean", *(axis for axis in CONTROLS if suite == "goal" or axis != "wrong-goal")]
        yield played(folder, f"experts-{suite}", experts, tasks_of(suite), EPISODE, conditions)


def played_baselines(folder: Path) -> Iterator[pd.DataFrame]:
    """Play the oracle, and a demonstration of each task open loop: a row per episode."""
    for suite in SUITES:
        replay = {"kind": "replay", "options": {"demonstrations": str(folder / "replays" / suite)}}
        policies: dict[str, dict[str, Any]] = {"oracle": {"kind": "oracle"}, "replay": replay}
        yield played(folder, f"baselines-{suite}", policies, tasks_of(suite), EPISODE)


def played_control(folder: Path) -> pd.DataFrame:
    """Play Goal's expert on a base of random weights: a row per episode."""
    control = {"random-base": {"kind": "mergevla", "options": {"checkpoint": str(folder / "random" / "libero-goal")}}}
    return played(folder, "random-base", control, tasks_of("goal"), EPISODE)


def played(
    folder: Path,
    name: str,
    policies: Mapping[str, Mapping[str, Any]],
    tasks: Sequence[str],
    columns: Sequence[str],
    conditions: Sequence[str] = ("clean",),
    states: int | None = None,
) -> pd.DataFrame:
    """Play policies on `STATES` or fewer stored states of tasks, or what the folder lacks of it: a row per episode."""
    states = states or STATES
    runs = {first: f"{name}-from-{first}" if first else name for first in range(0, few(states), RUN_STATES)}
    return pd.concat(
        play_policies(folder, run, policies, tasks, min(RUN_STATES, states - first), columns, conditions, first)
        for first, run in runs.items()
    )


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success by suite and in all with Wilson's interval. `frame` has a row per episode, with the columns `EPISODE`."""
    won = frame.assign(won=frame.status.map({"success": 1.0, "failure": 0.0}))
    rows: list[dict[str, object]] = []
    for (policy, axis), title in TITLES.items():
        own = won[(won.policy == policy) & (won.axis == axis)].set_index(["task", "seed"]).won
        rows.append({"policy": policy, "axis": axis, "title": title, **by_suite(own)})
    return rows


def by_suite(won: pd.Series) -> dict[str, str]:
    """Success in each suite and in all, with Wilson's interval; empty where nothing was played.

    Args:
        won: 1.0, 0.0, or NaN for an error, indexed by task and seed.
    """
    won = won.dropna()
    suites = won.index.get_level_values("task").map(suite_of)
    parts = {title: won[suites == suite] for suite, title in SUITES.items()}
    if all(map(len, parts.values())):
        parts["all"] = won
    return {"all": "", **{name: _rate(part) for name, part in parts.items()}}


def _rate(won: pd.Series) -> str:
    return percent(won.mean(), wilson_interval(int(won.sum()), len(won))) if len(won) else ""


def suite_of(task: str) -> str:
    """Part of LIBERO that a task is of: `goal` for `libero/goal-7-turn-on-stove`."""
    return task.partition("/")[2].partition("-")[0]


def folder_of_experts() -> Path:
    """The folder of `studies/libero/libero.sh`."""
    return folder_of("LIBERO", "libero")


def tasks_of(suite: str) -> list[str]:
    """The tasks of a suite's expert, or as many of them as are measured."""
    tasks = sorted(CheckpointMetadata.read(shipped(f"{EXPERTS}/libero-{suite}")).tasks)
    return tasks[: few(len(tasks), 1)]
