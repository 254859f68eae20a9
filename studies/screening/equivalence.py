"""Where merging costs less than the margin of the screening: by simulator, and by how well both policies do.

Counted in the kept report's episodes; a task's level counts if the oracle solves 95 % of its seeds, as in the report,
and an episode if its axis delivered something.
"""

from __future__ import annotations

from typing import Any

import pandas as pd

from robogauntlet.results.analysis.eligible_episodes import is_undelivered
from robogauntlet.results.statistics.aggregate import mean_of_levels
from robogauntlet.results.statistics.pairs import Pairs, mcnemar
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CONTROLS
from studies.shared import table_of
from studies.tables import STUDIES

MARGIN = 0.05
SOLVED = 0.95
COLUMNS = {
    name: f"{{{name}}}"
    for name in ("levels", "number", "pairs", "loss by merging, points", "p, any loss", "below 5 points")
}


def measure() -> list[dict[str, Any]]:
    """Count, and print the table."""
    table_of(rows := counted([]), COLUMNS)
    return rows


def counted(_: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for all perturbed levels, for those of each simulator, and for those where both policies do alike."""
    frame = pd.read_parquet(STUDIES / "screening/report/episodes.parquet")
    frame = frame[frame["axis"].isin(AXES.keys() - CONTROLS) & frame["status"].isin(["success", "failure"])]
    frame = frame[~is_undelivered(frame)]
    frame = frame.assign(
        won=1.0 * (frame["status"] == "success"), level=[*zip(frame["axis"], frame["severity"], strict=True)]
    )
    sides = frame.pivot_table(
        index=["simulator", "task", "level", "seed"], columns="policy", values="won", observed=True
    )
    solved = sides["oracle"].groupby(["task", "level"], observed=True).transform("mean") >= SOLVED
    pairs = sides[solved].dropna(subset=["experts", "merged"])
    rate = pairs[["experts", "merged"]].mean(axis=1).groupby("level").transform("mean")
    simulators = pairs.index.get_level_values("simulator")
    groups = {"all": rate >= 0}
    groups |= {str(name): simulators == name for name in sorted(simulators.unique())}
    groups |= {
        "both below 50 %": rate < 0.5,
        "both 50 to 85 %": (rate >= 0.5) & (rate < 0.85),
        "both 85 % or more": rate >= 0.85,
    }
    return [_row(name, pairs[chosen]) for name, chosen in groups.items()]


def _row(name: str, pairs: pd.DataFrame) -> dict[str, Any]:
    lost = (pairs["experts"] - pairs["merged"]).unstack("level")
    table = pd.crosstab(pairs["experts"], pairs["merged"]).reindex(index=[1, 0], columns=[1, 0], fill_value=0)
    loss = mean_of_levels([own.to_numpy() for _, own in lost.groupby("task", observed=True)], 0.9)
    assert loss is not None
    ends = loss.interval
    assert ends is not None
    return {
        "levels": name,
        "number": lost.shape[1],
        "pairs": len(pairs),
        "loss by merging, points": f"{100 * loss.value:+.1f} [{100 * ends.low:.1f}, {100 * ends.high:.1f}]",
        "p, any loss": f"{mcnemar(Pairs(*map(int, table.to_numpy().ravel()))):.2g}",
        "below 5 points": "shown" if ends.low > -MARGIN and ends.high < MARGIN else "not shown",
    }
