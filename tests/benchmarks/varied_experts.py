"""Experts of varied scenes beside the zoo's under seventeen axes at severity 2. Needs `scripts/varied_experts.sh`.

`RUN=FOLDER python -m tests.benchmarks varied_experts` reads its run (default `runs/varied-experts/run`).
"""

from __future__ import annotations

import os

import numpy as np
import pandas as pd

from robogauntlet.results.api import open_run
from robogauntlet.results.statistics.aggregate import percentile_interval, resampled_means
from robogauntlet.suites.episode import CLEAN
from tests.benchmarks.document import write_episodes
from tests.benchmarks.shared import table_of

EXPERTS, VARIED = "experts", "varied"
TRAINED_ON = (
    *("camera-orbit", "camera-distance", "field-of-view", "light-direction", "illuminance", "colour-temperature"),
    *("table", "distractors", "object-position", "robot-start"),
)
"""Axes along which the scenes of the demonstrations vary."""
EPISODE = ("policy", "task", "axis", "seed", "status")


def measure() -> list[dict[str, object]]:
    """A row for each axis and for groups of them; writes the episodes beside the rows."""
    frame = open_run(os.environ.get("RUN", "runs/varied-experts/run")).episodes(EPISODE)
    frame = frame[frame.policy.isin([EXPERTS, VARIED])]
    write_episodes("varied_experts", frame, EPISODE[:4])
    rows = rows_of(frame)
    columns = {"condition": "{name}", "episodes each": "{episodes}", "zoo's experts": "{experts:.0%}"}
    table_of(rows, columns | {"of varied scenes": "{varied:.0%}", "difference (points) [95 %]": "{difference}"})
    return rows


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success of both and their difference with a bootstrap interval over start states (task and seed).

    `frame` has a row per episode with the columns `EPISODE`.
    """
    axes = [axis for axis in frame.axis.unique() if axis != CLEAN]
    trained, others = ([axis for axis in axes if (axis in TRAINED_ON) is wanted] for wanted in (True, False))
    groups = {CLEAN: [CLEAN], f"{len(trained)} axes of the scenes": trained, f"{len(others)} other axes": others}
    groups |= {f"{axis}{'' if axis in TRAINED_ON else ' (other)'}": [axis] for axis in (*trained, *others)}
    rows = []
    for name, chosen in groups.items():
        won = frame[frame.axis.isin(chosen)].assign(won=lambda rows: (rows.status == "success").astype(float))
        sides = {
            side: won[won.policy == side].pivot(index=["task", "seed"], columns="axis", values="won")
            for side in (EXPERTS, VARIED)
        }
        differences = sides[VARIED] - sides[EXPERTS]
        strata = [own.to_numpy() for _, own in differences.groupby("task")]
        drawn = resampled_means(strata, np.random.default_rng(0)).mean(axis=(1, 2))
        ends = percentile_interval(100 * drawn)
        rates = {side: float(found.to_numpy().mean()) for side, found in sides.items()}
        points = f"{100 * float(differences.to_numpy().mean()):+.0f}"
        shown = f"{points} [{ends.low:+.0f}, {ends.high:+.0f}]" if ends else f"{points}, alike in all"
        rows.append({"name": name, "episodes": differences.size, **rates, "difference": shown})
    return rows
