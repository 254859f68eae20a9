"""LIBERO-PRO as the experts play it, their copies in four bits, and their merge: what each keeps of LIBERO's success.

`LIBERO=FOLDER python -m studies libero --measure libero_pro_ways` (default `runs/libero`) plays the zoo's experts of
Long, the copies and the merge, after `robogauntlet env create libero`; what the other experts did is taken from the
kept episodes, and so is LIBERO's own. What is finished in the folder is kept, so that the same command continues.
"""

from __future__ import annotations

import pandas as pd

from robogauntlet.results.statistics.pairs import Pairs, paired_difference
from studies.libero.libero_experts import EXPERTS as ZOO, SUITES, folder_of_experts, suite_of, tasks_of
from studies.libero.libero_merges import EPISODE, EXPERTS, MERGED, WAYS as MERGES
from studies.libero.libero_pro import AXES, PLAYED, STATES, rate, task_of
from studies.shared import merged_policy, play_policies, table_of
from studies.tables import episodes_of, write_episodes

COPIES, MERGE = "none-4", "magnitude-2-routed"
WAYS = {EXPERTS: "experts", COPIES: "copies in four bits", MERGE: "merge: two bits of magnitudes, routed"}
PARTS = {"Spatial, Object, Goal": PLAYED, "Long": ("10",)}
LONG_STATES = 1
"""Stored states of each task of Long, whose episodes take longest."""
COLUMNS = {
    "suites": "{suites}",
    "policy": "{title}",
    "LIBERO's own": "{own}",
    **{axis: f"{{{axis}}}" for axis in AXES},
    "all four": "{all}",
    "less than the experts (points)": "{less}",
    "routed right": "{routed}",
}


def measure() -> list[dict[str, object]]:
    """A row for each policy, Long apart; writes the episodes beside the rows."""
    folder, frames = folder_of_experts(), []
    by_suite = {suite: [task_of(axis, task) for axis in AXES for task in tasks_of(suite)] for suite in SUITES}
    experts = {EXPERTS: {"kind": "mergevla", "options": {"checkpoint": f"{ZOO}/libero-10"}}}
    copies = merged_policy(MERGED, recipe=MERGES[COPIES][1], experts=ZOO)
    ways = {COPIES: copies, MERGE: merged_policy(MERGED, "calibrated")}
    for state in range(STATES):
        suites = SUITES if state < LONG_STATES else PLAYED
        tasks = [task for suite in suites for task in by_suite[suite]]
        frames.append(play_policies(folder, f"pro-ways-state-{state}", ways, tasks, 1, EPISODE, first=state))
    for state in range(LONG_STATES):
        name = f"pro-experts-10-state-{state}"
        frames.append(play_policies(folder, name, experts, by_suite["10"], 1, EPISODE, first=state))
    frame = pd.concat(frames)
    write_episodes("libero_pro_ways", frame, ("policy", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success by policy and axis with Wilson's interval, and how much less it is than the experts' in the same states.

    `frame` has a row per episode that was played here, with the columns `EPISODE`.
    """
    kept = episodes_of("libero", "libero_pro")
    kept = kept[(kept.policy == EXPERTS) & (kept.axis == "clean")]
    every = pd.concat([frame, kept], ignore_index=True)
    plain = every.task.str.removeprefix("libero/pro-").str.partition("-")
    every = every.assign(won=every.status.map({"success": 1.0, "failure": 0.0}), pro_axis=plain[0])
    every = every.assign(suite=("libero/" + plain[2]).map(suite_of))
    own = episodes_of("libero", "libero_merges")
    own = own.assign(won=own.status.map({"success": 1.0, "failure": 0.0}), suite=own.task.map(suite_of))
    rows: list[dict[str, object]] = []
    for suites, names in PARTS.items():
        of_suites, of_own = every[every.suite.isin(names)], own[own.suite.isin(names)]
        table = of_suites.pivot(index=["task", "seed"], columns="policy", values="won")
        for policy, title in WAYS.items():
            its = of_suites[of_suites.policy == policy]
            row: dict[str, object] = {"suites": suites, "policy": policy, "title": title}
            row |= {"own": rate(of_own[of_own.policy == policy].won.dropna())}
            row |= {axis: rate(its[its.pro_axis == axis].won.dropna()) for axis in AXES}
            row |= {"all": rate(its.won.dropna()), "less": "", "routed": ""}
            if policy != EXPERTS:
                row["less"] = _less(table[[EXPERTS, policy]].dropna())
            if policy == MERGE:
                row["routed"] = f"{int((its.inferred_task == its.task).sum())} of {len(its)}"
            rows.append(row)
    return rows


def _less(won: pd.DataFrame) -> str:
    """Points by which the second column is below the first in the same episodes, with Newcombe's interval for pairs."""
    found = paired_difference(Pairs.from_outcomes(*won.to_numpy().T))
    if found is None or found.interval is None:
        return ""
    low, high = (100 * end for end in (found.interval.low, found.interval.high))
    return f"{100 * found.value:.0f} [{low:.0f}, {high:.0f}]"
