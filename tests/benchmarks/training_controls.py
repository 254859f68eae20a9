"""Success by kind of training, way of merging and training seed. Needs the runs of `scripts/training_controls.sh`.

`TRAINING_CONTROLS=FOLDER python -m tests.benchmarks training_controls` (default `runs/training-controls`). Policies
that are not in the folder keep their committed episodes, with the machine that played them, so that one kind at a time
can be trained. A part of a training (`PERCENT`) is not mixed with them.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from robogauntlet.results.api import open_run
from tests.benchmarks.document import MEASUREMENTS, machine, write_episodes
from tests.benchmarks.shared import table_of

REFERENCE = "cross-sigmoid"
"""MergeVLA's own block on a base of the same tasks, which the others are compared with."""
KINDS = {
    "cross-sigmoid": "trunk from the base",
    "cross-sigmoid-fresh": "trunk from a seed of its own",
    "other": "base of four other tasks",
    "other-fresh": "base of other tasks, own trunks",
    "matched": "base of other tasks without actions",
    "matched-fresh": "base without actions, own trunks",
    "quirks": "errors of the released code",
    "cross-tanh": "tanh gate",
    "self-sigmoid": "self-attention",
    "self-tanh": "self-attention, tanh gate",
}
"""Names in the table."""
WAYS = {
    "experts": "experts",
    "signs": "two bits of magnitudes",
    "ta-s": "TA+S, trunk by vectors",
    "paper": "TA+S, averaged trunk",
    "joint": "joint training",
}
NAME = rf"(?:(?P<kind>.+)-)?(?P<way>{'|'.join(WAYS)})-(?P<training>\d+)"
"""A policy of the runs: kind of training (none for joint training), way of merging, training seed."""
EPISODE = ("policy", "task", "seed", "status")


def measure() -> list[dict[str, object]]:
    """A row for each kind of training and way of merging; writes the episodes beside the rows."""
    folder = Path(os.environ.get("TRAINING_CONTROLS", "runs/training-controls"))
    played = pd.concat([open_run(run).episodes(EPISODE) for run in sorted(folder.glob("run-*"))])
    frame = with_committed(
        played.assign(machine=machine()), pd.read_parquet(MEASUREMENTS / "training_controls.parquet")
    )
    write_episodes("training_controls", frame, EPISODE[:3])
    rows = rows_of(frame)
    columns = {"training": "{title}", "way of merging": "{way}", "success by training seed (%)": "{seeds}"}
    columns |= {"mean": "{mean:.0f}", "to its experts (points)": "{to_experts}"}
    table_of(rows, columns | {f"to {KINDS[REFERENCE]} (points)": "{to_reference}"})
    return rows


def with_committed(played: pd.DataFrame, committed: pd.DataFrame) -> pd.DataFrame:
    """The episodes that were played, and those of other policies that are committed, if all have equally many."""
    if set(played.groupby("policy").size()) != set(committed.groupby("policy").size()):
        return played
    return pd.concat([committed[~committed.policy.isin(played.policy)], played])


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success, mean of the tasks, with differences paired by training seed and their 95 % t-intervals.

    `frame` has a row per episode with the columns `EPISODE`.
    """
    named = frame.policy.str.extract(f"^{NAME}$").fillna({"kind": REFERENCE})
    won = named.assign(task=frame.task, won=100.0 * (frame.status == "success"))
    rates = won.groupby(["kind", "way", "training", "task"]).won.mean().groupby(["kind", "way", "training"]).mean()
    by_seed = rates.unstack("training")
    rows = []
    for kind, way in sorted(by_seed.index, key=lambda key: (key[0] != REFERENCE, key[0], list(WAYS).index(key[1]))):
        own, experts = by_seed.loc[(kind, way)], by_seed.loc[(REFERENCE if way == "joint" else kind, "experts")]
        rows.append(
            {
                "kind": kind if way != "joint" else "-",
                "title": KINDS.get(kind, kind) if way != "joint" else "one network on all tasks",
                "way": WAYS[way],
                "seeds": " / ".join(f"{rate:.0f}" for rate in own.dropna()),
                "mean": float(own.mean()),
                "to_experts": "" if way == "experts" else _difference(own - experts),
                "to_reference": ""
                if kind == REFERENCE or (REFERENCE, way) not in by_seed.index
                else _difference(own - by_seed.loc[(REFERENCE, way)]),
            }
        )
    return rows


def _difference(points: pd.Series) -> str:
    points = points.dropna()
    if len(points) < 2:
        return f"{points.mean():+.0f}, one seed"
    half = stats.t.ppf(0.975, len(points) - 1) * points.std(ddof=1) / np.sqrt(len(points))
    return f"{points.mean():+.0f} [{points.mean() - half:+.0f}, {points.mean() + half:+.0f}]"
