"""Success of experts, their copies in four bits and the merged policy against the time that their answers take.

`LATENCY=FOLDER python -m studies latency --measure latency` (default `runs/latency`) plays the zoo's nine tasks in four
modes: a simulation that waits, and a robot that holds, continues or blends. What is finished is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from robogauntlet.results.report.figure_style import COLOURS, GRID, STYLE
from robogauntlet.results.report.formatting import points
from robogauntlet.results.report.sections.latency import DOING
from robogauntlet.results.statistics.pairs import Pairs, paired_difference
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.suites.axes import AXES, LATENCY
from studies.merging.operators import percent
from studies.percent import folder_of
from studies.shared import merged_policy, play_policies, table_of
from studies.tables import WRITTEN, episodes_of, write_episodes

POLICIES: dict[str, dict[str, Any]] = {
    "experts": {"kind": "mergevla-experts", "options": {"folder": "zoo:experts"}},
    "four bits each": merged_policy(
        "zoo:merged", recipe={"operator": "none", "masks": "none", "options": {"bits": 4}}, experts="zoo:experts"
    ),
    "merged": merged_policy("zoo:merged"),
}
TASKS = (
    *("maniskill/PushCube-v1", "maniskill/PullCube-v1", "maniskill/StackCube-v1"),
    *("pybullet/PandaReach-v3", "pybullet/PandaPush-v3", "pybullet/PandaPickAndPlace-v3"),
    *("robosuite/Lift", "robosuite/Stack", "robosuite/Door"),
)
SEEDS = 10
LEVELS = range(1, 6)
EPISODE = (
    *("policy", "task", "axis", "severity", "seed", "status", "steps", "queries"),
    *("held_steps", "stale_steps", "observation_age", "chunk_share"),
)
MODES = {axis: str(mode) for axis, mode in LATENCY.items()}
COLUMNS = {
    "policy": "{policy}",
    "simulator": "{simulator}",
    "robot": "{mode}",
    "0 ms": "{rate_0}",
    **{f"{AXES['latency'].value(level):g} ms": f"{{rate_{level}}}" for level in LEVELS},
    "lost at 100 ms": "{lost}",
    "steps held at 100 ms": "{held}",
}
SHOWN = 2
"""The level of which the loss and the steps held are shown."""


def measure() -> list[dict[str, Any]]:
    """A row for each policy, mode and simulator; writes the episodes beside the rows."""
    levels = ",".join(map(str, LEVELS))
    conditions = ("clean", *(f"{axis}@{levels}" for axis in MODES))
    folder = folder_of("LATENCY", "latency")
    policies = {name.replace(" ", "-"): policy for name, policy in POLICIES.items()}
    frame = play_policies(folder, "latency", policies, TASKS, SEEDS, EPISODE, conditions)
    write_episodes("latency", frame, ("policy", "task", "axis", "severity", "seed"))
    rows = rows_of(frame)
    draw(rows, WRITTEN / "success-by-latency.svg")  # docs/images/latency.svg
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, from the kept episodes."""
    return rows_of(episodes_of("latency", "latency"))


def rows_of(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Success by latency, the loss at one of them, paired by seed, and how many of its steps the robot held there.

    Simulator by simulator for the experts, over all of them for each policy.

    Args:
        frame: A row per episode with the columns `EPISODE`.
    """
    frame = frame.assign(won=frame["status"].map({"success": 1.0, "failure": 0.0}))
    rows = []
    for policy in POLICIES:
        own = frame[frame["policy"] == policy.replace(" ", "-")]
        simulators = sorted({task.partition("/")[0] for task in own["task"]}) if policy == "experts" else []
        for simulator in ("all", *simulators):
            inside = own if simulator == "all" else own[own["task"].str.startswith(f"{simulator}/")]
            rows += [row_of(inside, policy, simulator, axis) for axis in MODES]
    return rows


def row_of(
    inside: pd.DataFrame, policy: str, simulator: str, axis: str, played: Sequence[int] = LEVELS
) -> dict[str, Any]:
    """The row of a policy in a mode, from its episodes; those levels were played."""
    clean = inside[inside["axis"] == "clean"]
    levels = {0: clean, **{level: inside[(inside["axis"] == axis) & (inside["severity"] == level)] for level in played}}
    row: dict[str, Any] = {"policy": policy, "simulator": simulator, "mode": MODES[axis]}
    for level, found in levels.items():
        won, count = int(found["won"].sum()), int(found["won"].count())
        row[f"rate_{level}"] = percent(won / count, wilson_interval(won, count)) if count else ""
        row[f"counts_{level}"] = (won, count)
    both = clean.merge(levels[SHOWN], on=["task", "seed"], suffixes=("", "_late"))
    lost = paired_difference(Pairs.from_outcomes(both["won"].to_numpy(), both["won_late"].to_numpy()))
    row["lost"] = "" if lost is None else points(lost)
    row["held"] = f"{100 * levels[SHOWN]['held_steps'].sum() / levels[SHOWN]['steps'].sum():.0f} %"
    return row


def draw(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw success over all simulators against latency with Wilson's intervals, a panel for each mode."""
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    latencies = [0.0, *(AXES["latency"].value(level) for level in LEVELS)]
    with mpl.rc_context(STYLE):
        figure, panels = plt.subplots(1, len(MODES), figsize=(6.7, 2.2), sharey=True, layout="constrained")
        for panel, mode in zip(panels, MODES.values(), strict=True):
            for colour, policy in zip(COLOURS, POLICIES, strict=False):
                (row,) = (r for r in rows if (r["policy"], r["simulator"], r["mode"]) == (policy, "all", mode))
                counts = [row[f"counts_{level}"] for level in range(len(latencies))]
                ends = [wilson_interval(won, count) for won, count in counts]
                low, high = [100 * one.low for one in ends if one], [100 * one.high for one in ends if one]
                panel.plot(
                    latencies,
                    [100 * won / count for won, count in counts],
                    "o-",
                    color=colour,
                    markersize=3,
                    linewidth=0.8,
                    label=policy,
                )
                panel.fill_between(latencies, low, high, color=colour, alpha=0.15, linewidth=0)
            panel.set_title(f"robot {DOING[mode]}")
            panel.set_xlabel("latency of answers (ms)")
            panel.set_ylim(0, 101)
            panel.grid(**GRID)
        panels[0].set_ylabel("success, %")
        panels[-1].legend(frameon=False)
        figure.savefig(path, metadata={"Date": None})
        plt.close(figure)
