"""LIBERO's experts in LIBERO-PRO, told what its definitions say and what file names say, beside LIBERO's own tasks.

`LIBERO=FOLDER python -m studies libero --measure libero_pro` (default `runs/libero`) plays the zoo's experts and the
oracle, after `robogauntlet env create libero`; what the experts did in LIBERO's own tasks is taken from the kept
episodes. What is finished in the folder is kept, so that the same command continues.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd
from scipy import stats

from robogauntlet.adapters.catalog import original
from robogauntlet.policies.oracles.libero import SCRIPTS
from robogauntlet.results.statistics.rates import wilson_interval
from studies.libero.libero_experts import EPISODE, EXPERTS, folder_of_experts, suite_of, tasks_of
from studies.merging.operators import percent
from studies.shared import play_policies, table_of
from studies.tables import episodes_of, write_episodes

AXES = ("object", "swap", "task", "language")
PLAYED = ("spatial", "object", "goal")
"""Suites; those of `10` are in `libero_pro_ways`."""
STATES = 2
"""Stored states of each task, from the first on; each is a run, so that what was played stays valid when more are."""
NAMED = "variant-name"
COLUMNS = {
    "axis": "{pro_axis}",
    "oracle": "{oracle}",
    "experts": "{experts}",
    "less than in LIBERO (points)": "{lost}",
    "told the file's name": "{named}",
    "less than in LIBERO (points), told so": "{named-lost}",
}


def measure() -> list[dict[str, object]]:
    """A row for LIBERO and for each axis; writes the episodes beside the rows."""
    frame = pd.concat(_played(folder_of_experts()))
    write_episodes("libero_pro", frame, ("policy", "axis", "task", "seed"))
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def _played(folder: Path) -> Iterator[pd.DataFrame]:
    by_suite = {suite: [task_of(axis, task) for axis in AXES for task in tasks_of(suite)] for suite in PLAYED}
    scripted = [task for tasks in by_suite.values() for task in tasks if task in SCRIPTS]
    oracle = {"oracle": {"kind": "oracle"}}
    for state in range(STATES):
        for suite, tasks in by_suite.items():
            expert = {"experts": {"kind": "mergevla", "options": {"checkpoint": f"{EXPERTS}/libero-{suite}"}}}
            name = f"pro-experts-{suite}-state-{state}"
            yield play_policies(folder, name, expert, tasks, 1, EPISODE, ["clean", NAMED], state)
        yield play_policies(folder, f"pro-oracle-state-{state}", oracle, scripted, 1, EPISODE, first=state)


def task_of(axis: str, task: str) -> str:
    """LIBERO-PRO's task of an axis by LIBERO's."""
    return task.replace("libero/", f"libero/pro-{axis}-")


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success by axis with Wilson's interval, and what is lost by task. `frame` has a row per episode of LIBERO-PRO."""
    frame = frame.assign(
        won=frame.status.map({"success": 1.0, "failure": 0.0}),
        pro_axis=frame.task.str.removeprefix("libero/pro-").str.partition("-")[0],
    )
    own = episodes_of("libero", "libero_experts")
    own = own[(own.axis == "clean") & own.task.map(suite_of).isin(PLAYED)]
    own = own.assign(won=own.status == "success")
    in_libero = {policy: rate(own[own.policy == policy].won) for policy in ("oracle", "experts")}
    first: dict[str, object] = {"pro_axis": "LIBERO's own", "lost": "", "named": in_libero["experts"], "named-lost": ""}
    by_task = own[own.policy == "experts"].groupby("task").won.mean()
    return [first | in_libero, *(_row(axis, frame[frame.pro_axis == axis], by_task) for axis in AXES)]


def _row(axis: str, frame: pd.DataFrame, own: pd.Series) -> dict[str, object]:
    experts, oracle = (frame[frame.policy == policy] for policy in ("experts", "oracle"))
    told, named = (experts[experts.axis == axis] for axis in ("clean", NAMED))
    named = pd.concat([named, told[~told.task.isin(named.task)]])  # the rest is told the same
    return {
        "pro_axis": axis,
        "oracle": rate(oracle.won.dropna()),
        "experts": rate(told.won.dropna()),
        "lost": _lost(told, own),
        "named": rate(named.won.dropna()),
        "named-lost": _lost(named, own),
    }


def _lost(played: pd.DataFrame, own: pd.Series) -> str:
    """Points by which success is lower than in LIBERO's own tasks: mean over tasks, with Student's interval."""
    by_task = played.dropna(subset="won").groupby("task").won.mean()
    lost = 100.0 * (own[by_task.index.map(original)].to_numpy() - by_task.to_numpy())
    low, high = stats.ttest_1samp(lost, 0.0).confidence_interval(0.95)
    return f"{lost.mean():.0f} [{low:.0f}, {high:.0f}]"


def rate(won: pd.Series) -> str:
    """Success with Wilson's interval, in percent; empty without episodes. `won` has 1 or 0 for each."""
    return percent(won.mean(), wilson_interval(int(won.sum()), len(won))) if len(won) else ""
