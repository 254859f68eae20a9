"""Success by kind of training, way of merging and training seed. Needs the runs of `scripts/training_controls.sh`.

`TRAINING_CONTROLS=FOLDER python -m tests.benchmarks training_controls`
"""

import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from robogauntlet.results.api import open_run
from tests.benchmarks.shared import table

REFERENCE = "cross-sigmoid"
"""MergeVLA's own block, which the others are compared with."""
EXPERTS, JOINT = "experts", "joint"
WAYS = (EXPERTS, "signs", "ta-s", "paper")


def measure() -> list[dict[str, object]]:
    """Mean success over tasks for each training, and differences between blocks and ways of merging."""
    folder = Path(os.environ.get("TRAINING_CONTROLS", "runs/training-controls"))
    rows = pd.concat([open_run(run).episodes() for run in sorted(folder.glob("run-*"))])
    rows["success"] = rows.status == "success"
    rows[["name", "training"]] = rows.policy.str.rsplit("-", n=1, expand=True)
    trained = rows.groupby(["name", "training", "task"]).success.agg(["mean", "count"]).reset_index()
    by_training = trained.groupby(["name", "training"])["mean"].mean().unstack()
    chance = _chance(trained)
    print("success, mean of the tasks, by training seed; deviation between seeds, and the part due to drawing episodes")
    table(
        ("network", *by_training.columns, "mean", "deviation", "of episodes"),
        [
            (name, *map(_percent, seeds), _percent(seeds.mean()), _percent(seeds.std(ddof=1)), _percent(chance[name]))
            for name, seeds in by_training.iterrows()
        ],
    )
    print(f"\ndifference to {REFERENCE} in points, paired by training seed, 95 % t-interval over the seeds")
    differences = [
        (name, way, *_difference(by_training.loc[name], by_training.loc[f"{REFERENCE}-{way}"]))
        for way in WAYS
        for name in by_training.index
        if name.endswith(f"-{way}") and name != f"{REFERENCE}-{way}"
    ]
    if JOINT in by_training.index:
        together = _difference(by_training.loc[JOINT], by_training.loc[f"{REFERENCE}-{EXPERTS}"])
        differences.append((JOINT, EXPERTS, *together))
    table(("network", "way", "difference", "interval"), differences)
    print("\ndifference between ways in points, 95 % t-interval over the training seeds")
    kinds = [name.removesuffix(f"-{EXPERTS}") for name in by_training.index if name.endswith(f"-{EXPERTS}")]
    ways = [
        (kind, better, worse, *_difference(by_training.loc[f"{kind}-{better}"], by_training.loc[f"{kind}-{worse}"]))
        for kind in kinds
        for better, worse in pairwise(WAYS)
    ]
    table(("network", "way", "to", "difference", "interval"), ways)
    print("\nsuccess by task, mean over training seeds")
    by_task = trained.groupby(["name", "task"])["mean"].mean().unstack()
    table(("network", *by_task.columns), [(name, *map(_percent, found)) for name, found in by_task.iterrows()])
    return [{"network": name, **found.to_dict()} for name, found in by_training.iterrows()]


def _chance(trained: pd.DataFrame) -> pd.Series:
    """Deviation of a training's mean over tasks that is due to drawing episodes, by network."""
    variance = (trained["mean"] * (1 - trained["mean"]) / trained["count"]).groupby(
        [trained["name"], trained["training"]]
    )
    return np.sqrt(variance.sum()).div(variance.size()).groupby("name").mean()


def _difference(ours: pd.Series, reference: pd.Series) -> Sequence[str]:
    points = (ours - reference).dropna() * 100
    if len(points) < 2:
        return f"{points.mean():+.1f}", "one seed"
    half = stats.t.ppf(0.975, len(points) - 1) * points.std(ddof=1) / np.sqrt(len(points))
    return f"{points.mean():+.1f}", f"[{points.mean() - half:+.1f}, {points.mean() + half:+.1f}]"


def _percent(share: float) -> str:
    return "-" if np.isnan(share) else f"{share:.1%}"
