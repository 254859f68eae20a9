"""Success by kind of training, way of merging and training seed, from the runs of `training_controls.sh`.

`TRAINING_CONTROLS=FOLDER python -m studies merging --measure training_controls` (default `runs/training-controls`).
Policies that are not in the folder keep their committed episodes, with the machine that played them, so that one kind
at a time can be trained. A part of a training (`PERCENT`) is not mixed with them.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import stats

from robogauntlet.results.api import open_run
from studies.percent import folder_of
from studies.shared import table_of
from studies.tables import episodes_of, machine, write_episodes

REFERENCE = "cross-sigmoid"
"""MergeVLA's own block on a base of the same tasks, which the others are compared with."""
JOINT = "joint"
KINDS = {
    "cross-sigmoid": "trunk from the base",
    "cross-sigmoid-fresh": "trunk from a seed of its own",
    "other": "base of four other tasks",
    "other-fresh": "base of other tasks, own trunks",
    "matched": "base of other tasks without actions",
    "matched-fresh": "base without actions, own trunks",
    "cross-tanh": "tanh gate",
    "self-sigmoid": "self-attention",
    "self-tanh": "self-attention, tanh gate",
    "self-tanh-fresh": "self-attention, tanh gate, own trunks",
    "quirks": "errors of the released code",
    JOINT: "one network on all five tasks",
}
"""Kind of training to its name, in the order of the table."""
WAYS = {
    "experts": "experts",
    "signs": "one bit of magnitudes",
    "ta-s": "TA+S, trunk by vectors",
    "paper": "TA+S, averaged trunk",
}
NAME = rf"(?P<kind>.+?)(?:-(?P<way>{'|'.join(WAYS)}))?-(?P<training>\d+)"
"""A policy of the runs: kind of training, way of merging (none for joint training), training seed."""
EPISODE = ("policy", "task", "seed", "status")


def measure() -> list[dict[str, object]]:
    """A row for each kind of training; writes the episodes beside the rows."""
    folder = folder_of("TRAINING_CONTROLS", "training-controls")
    played = pd.concat([open_run(run).episodes(EPISODE) for run in sorted(folder.glob("run-*"))])
    frame = with_committed(played.assign(machine=machine()), episodes_of("merging", "training_controls"))
    write_episodes("training_controls", frame, EPISODE[:3])
    rows = rows_of(frame)
    table_of(rows, {"training": "{title}"} | {title: f"{{{way}}}" for way, title in WAYS.items()})
    return rows


def with_committed(played: pd.DataFrame, committed: pd.DataFrame) -> pd.DataFrame:
    """The episodes that were played, and those of other policies that are committed, if all have equally many."""
    if set(played.groupby("policy").size()) != set(committed.groupby("policy").size()):
        return played
    return pd.concat([committed[~committed.policy.isin(played.policy)], played])


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success by kind of training and way of merging (%, mean of the tasks), with what it was in each training.

    Beside it is the difference to the same way with `REFERENCE` (points), paired by training seed, with its 95 %
    t-interval. `frame` has a row per episode with the columns `EPISODE`.
    """
    named = frame.policy.str.extract(f"^{NAME}$").fillna({"way": "experts"})
    won = named.assign(task=frame.task, won=100.0 * (frame.status == "success"))
    rates = won.groupby(["kind", "way", "training", "task"]).won.mean().groupby(["kind", "way", "training"]).mean()
    by_seed = rates.unstack("training")
    rows: list[dict[str, object]] = []
    for kind in (kind for kind in KINDS if kind in by_seed.index):
        own = {way: by_seed.loc[kind, way].dropna() for way in WAYS if (kind, way) in by_seed.index}
        cells = {way: _by_training(rates) for way, rates in own.items()}
        if kind != REFERENCE and REFERENCE in by_seed.index:
            apart = {way: (rates - by_seed.loc[REFERENCE, way]).dropna() for way, rates in own.items()}
            cells |= {way: f"{cells[way]}: {_difference(points)}" for way, points in apart.items() if len(points)}
        means = {way: float(rates.mean()) for way, rates in own.items()}
        rows.append({"kind": kind, "title": KINDS[kind], "mean": means, **dict.fromkeys(WAYS, ""), **cells})
    return rows


def _by_training(rates: pd.Series) -> str:
    each = f" ({' / '.join(f'{rate:.0f}' for rate in rates)})" if len(rates) > 1 else ""
    return f"{rates.mean():.0f}{each}"


def _difference(points: pd.Series) -> str:
    if len(points) < 2:
        return f"{round(points.mean()):+d}"
    half = stats.t.ppf(0.975, len(points) - 1) * points.std(ddof=1) / np.sqrt(len(points))
    mean, low, high = (round(end) for end in (points.mean(), points.mean() - half, points.mean() + half))
    return f"{mean:+d} [{low:+d}, {high:+d}]"
