"""Known tasks that the shipped router takes for unknown ones, counted in the episodes of the screening.

`merged` reads the instruction; its router has a score and the threshold that was fitted to reject 5 % of clean known
observations. `python -m studies routing --measure false_alarms` counts; no episode is played.
"""

from __future__ import annotations

from typing import Any

import pandas as pd
from scipy.stats import mannwhitneyu

from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CONTROLS
from studies.shared import table_of
from studies.tables import STUDIES

SHOWN = ("instruction", "table", "illuminance")
COLUMNS = {
    name: f"{{{name}}}"
    for name in ("known tasks under", "observations", "rejected", "AUROC", "routed right", "refused")
}


def measure() -> list[dict[str, Any]]:
    """Count, and print the table."""
    table_of(rows := counted([]), COLUMNS)
    return rows


def counted(_: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each condition: first observations rejected, and how well their score tells them from clean ones.

    AUROC is the chance that the observation has a higher score than a clean one; "refused" is the share of the
    successful episodes that the threshold would have refused.
    """
    frame = pd.read_parquet(STUDIES / "screening/report/episodes.parquet")
    frame = frame[(frame["policy"] == "merged") & (frame["status"] != "error")]
    clean = frame[frame["axis"] == "clean"]
    conditions = {"clean scenes": clean}
    for axis in SHOWN:
        for severity in (2, 4):
            chosen = (frame["axis"] == axis) & (frame["severity"] == severity)
            conditions[f"{axis}@{severity}"] = frame[chosen]
    for severity in (2, 4):
        conditions[f"all axes, severity {severity}"] = frame[
            frame["axis"].isin(AXES.keys() - CONTROLS) & (frame["severity"] == severity)
        ]
    return [_row(name, seen, clean) for name, seen in conditions.items()]


def _row(name: str, seen: pd.DataFrame, clean: pd.DataFrame) -> dict[str, Any]:
    won = seen[seen["status"] == "success"]
    auroc = mannwhitneyu(seen["unknown_score"], clean["unknown_score"]).statistic / (len(seen) * len(clean))
    return {
        "known tasks under": name,
        "observations": len(seen),
        "rejected": _share(seen["rejected"]),
        "AUROC": "" if seen is clean else f"{auroc:.3f}",
        "routed right": _share(seen["inferred_task"].astype(str) == seen["task"].astype(str)),
        "refused": _share(won["rejected"]),
    }


def _share(which: pd.Series) -> str:
    which = which.astype(bool)
    ends = wilson_interval(int(which.sum()), len(which))
    return f"{100 * which.mean():.0f} % [{100 * ends.low:.0f}, {100 * ends.high:.0f}]" if ends else "none"
