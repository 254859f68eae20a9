"""Whether graded defects are put in order, and where `search checkpoint` says that builds became worse.

The search's own function is asked, with the outcomes that were played: its seeds in a random order, as many times as
comparisons are drawn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from robogauntlet.results.statistics.bisection import BATCH, Bisection, EndsDoNotDiffer, bisect_checkpoints
from studies.instrument.draws import DRAWS, REFERENCE, SEEDS, builds, episodes_of_builds
from studies.instrument.instrument import DEFECTS, TASKS
from studies.shared import table_of
from studies.tables import episodes_of

SERIES = {
    "bits": ("bits-4", "bits-3", "bits-2"),
    "noise": ("noise-06", "noise-12", "noise-20"),
    "delay": ("delay-1", "delay-2"),
    "all, by success": tuple(DEFECTS),
}
"""Checkpoints of a search after the reference, which is the good one; the last is the bad one."""
COLUMNS = (
    {"series": "{series}", "loses half": "{first}"}
    | {f"in order, {', '.join(map(str, SEEDS))} seeds (%)": "{order}"}
    | {"found": "{right}", "range": "{range}", "nothing": "{nothing}", "wrong": "{wrong}", "episodes": "{episodes}"}
)


def measure() -> list[dict[str, Any]]:
    """A row for each series."""
    rows = rows_of(episodes_of_builds(builds()))
    table_of(rows, COLUMNS)
    return rows


def counted(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The same of the kept episodes."""
    return rows_of(episodes_of("instrument", "instrument"))


def rows_of(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """A row for each series; `frame` has the columns `EPISODE`."""
    return [_row(name, outcomes_of(frame, (REFERENCE, *chain))) for name, chain in SERIES.items()]


def outcomes_of(frame: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Outcomes (1 or 0), a row per seed and task, ordered by these, and a column per build."""
    won = frame.assign(won=(frame["status"] == "success").astype(float))
    table = won[won["build"].isin(names)].pivot(index=["seed", "task"], columns="build", values="won")
    return table[list(names)].dropna()


def _row(name: str, outcomes: pd.DataFrame) -> dict[str, Any]:
    means = outcomes.mean()
    if name.startswith("all"):
        outcomes = outcomes[means.sort_values(ascending=False, kind="stable").index]
        means = outcomes.mean()
    half = (means.iloc[0] + means.iloc[-1]) / 2
    first = int(np.argmax(means.to_numpy() <= half))
    row: dict[str, Any] = {"series": name, "first": DEFECTS[str(outcomes.columns[first])]}
    tasks = len(TASKS)
    values = outcomes.to_numpy().reshape(-1, tasks, outcomes.shape[1])  # seeds, tasks, builds
    row["order"] = ", ".join(f"{100 * _in_order(values, count):.0f}" for count in SEEDS)
    generator = np.random.default_rng(0)
    found = [searched(generator.permutation(values)) for _ in range(DRAWS)]
    answers = [one for one in found if one is not None]
    right = [one.is_found and one.first_worse == first for one in answers]
    inside = [not one.is_found and one.last_good < first <= one.first_worse for one in answers]
    row |= {"right": percent(sum(right) / DRAWS), "range": percent(sum(inside) / DRAWS)}
    row |= {"nothing": percent(1 - len(answers) / DRAWS)}
    row |= {"wrong": percent((len(answers) - sum(right) - sum(inside)) / DRAWS)}
    row["episodes"] = f"{np.mean([one.episodes for one in answers]):.0f} of {values.size}" if answers else "-"
    return row


def _in_order(values: NDArray[np.float64], count: int) -> float:
    """The share of draws of so many seeds in which no grade succeeds more often than the one before."""
    generator = np.random.default_rng(count)
    drawn = (generator.choice(values, count).mean(axis=(0, 1)) for _ in range(DRAWS))
    return float(np.mean([np.all(np.diff(rates) <= 0) for rates in drawn]))


def searched(values: NDArray[np.float64]) -> Bisection | None:
    """What `search checkpoint` finds; None if the ends are not shown to differ.

    Args:
        values: Outcomes, shape (seeds, tasks, builds), played in the order of the seeds.
    """
    items = values.reshape(-1, values.shape[2])
    batch = math.ceil(BATCH / values.shape[1]) * values.shape[1]
    try:
        return bisect_checkpoints(
            values.shape[2] - 1,
            lambda build, asked: items[asked.start : asked.stop, build],
            batch=batch,
            most_seeds=len(items),
        )
    except EndsDoNotDiffer:
        return None


def percent(share: float) -> str:
    """A share in whole percent."""
    return f"{100 * share:.0f} %"
