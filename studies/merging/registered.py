"""The registered comparison of merges and quantised copies with the experts, and the same by simulator and under shift.

`RUN=FOLDER SHIFTED=FOLDER python -m studies merging --measure registered` reads runs of the two suites instead of
playing them. The seeds, margins and levels were committed before an episode was played.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from robogauntlet.results.api import open_run
from robogauntlet.results.statistics.aggregate import mean_of_levels
from robogauntlet.results.statistics.pairs import Pairs, paired_difference
from robogauntlet.results.statistics.rates import wilson_interval
from studies.shared import run_suite, table_of
from studies.tables import WRITTEN, episodes_of

CLEAN, SHIFTED = "clean", "shifted"
BASELINE, ROUTED = "experts", ("merged-reading", "merged-instruction-hidden", "paper")
BY_SIMULATOR = ("merged-told", "merged-instruction-hidden", "unmerged-int4")
"""Those that are shown by simulator; `merged-reading` is as `merged-told` there."""
MARGINS = {"all": 0.03}
MARGIN = 0.05
"""Of every part but the whole: simulators and shifted scenes."""
FAMILY = 5
"""Comparisons with the experts, to which the level of every interval is adjusted (Bonferroni)."""
CONFIDENCE = 1 - 0.1 / FAMILY
"""Two one-sided tests at 5 % over the family: 98 %."""
COLUMNS = {
    "episodes": "{part}",
    "policy": "{policy}",
    "success": "{success}",
    "loss against the experts, points": "{loss}",
    "verdict": "{verdict}",
    "right expert": "{routed}",
}
KEPT = ("simulator", "task", "axis", "severity", "seed", "policy", "status", "inferred_task")


def measure() -> list[dict[str, Any]]:
    """Play both suites, or read their runs; keep the episodes."""
    with tempfile.TemporaryDirectory() as name:
        frames = []
        for variable, suite in (("RUN", "registered"), ("SHIFTED", "registered_shifted")):
            folder = Path(os.environ.get(variable, f"{name}/{suite}"))
            if variable not in os.environ:
                run_suite(Path(__file__).with_name(f"{suite}.yaml"), folder)
            frames.append(open_run(folder).episodes(KEPT).assign(suite=suite))
    frame = pd.concat(frames, ignore_index=True)
    WRITTEN.mkdir(parents=True, exist_ok=True)
    frame.sort_values(["suite", *KEPT[:6]]).to_parquet(WRITTEN / "registered.parquet", index=False)
    rows = rows_of(frame)
    table_of(rows, COLUMNS)
    return rows


def counted(_: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows again, from the kept episodes."""
    return rows_of(episodes_of("merging", "registered"))


def rows_of(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """A row for each policy in each part: all clean episodes, those of each simulator, and the shifted scenes."""
    clean, shifted = (frame[frame["suite"] == suite] for suite in ("registered", "registered_shifted"))
    shifted = shifted[shifted["axis"] != CLEAN]
    parts = {"all": clean} | {str(name): part for name, part in clean.groupby("simulator")} | {SHIFTED: shifted}
    return [
        _row(name, part, policy)
        for name, part in parts.items()
        for policy in part["policy"].unique()
        if name in ("all", SHIFTED) or policy in BY_SIMULATOR
    ]


def _row(name: str, part: pd.DataFrame, policy: str) -> dict[str, Any]:
    won = part.assign(won=part["status"] == "success")[part["status"].isin(["success", "failure"])]
    sides = won.pivot_table(index=["task", "axis", "severity", "seed"], columns="policy", values="won", dropna=False)
    own = sides[policy].dropna()
    row: dict[str, Any] = {"part": name, "policy": policy, "success": _share(int(own.sum()), len(own))}
    row |= {"loss": "", "verdict": "", "routed": ""}
    if policy in ROUTED:
        mine = part[(part["policy"] == policy) & part["inferred_task"].notna()]
        row["routed"] = _share(int((mine["inferred_task"] == mine["task"]).sum()), len(mine))
    if policy == BASELINE:
        return row
    both = sides[[BASELINE, policy]].dropna()
    pairs = Pairs.from_outcomes(both[BASELINE].to_numpy(), both[policy].to_numpy())
    if name == SHIFTED:  # the levels of a seed share its start
        lost = (both[BASELINE] - both[policy]).astype(float).unstack(["axis", "severity"])
        loss = mean_of_levels([own.to_numpy() for _, own in lost.groupby("task")], CONFIDENCE)
    else:
        loss = paired_difference(pairs, CONFIDENCE)
    assert loss is not None
    if (ends := loss.interval) is None:  # all seeds are alike
        return row | {"loss": f"{100 * loss.value:+.1f}", "verdict": "neither shown"}
    margin = MARGINS.get(name, MARGIN)
    verdicts = []
    if ends.low > 0 or ends.high < 0:
        verdicts.append("worse" if ends.low > 0 else "better")
    if -margin < ends.low and ends.high < margin:
        verdicts.append(f"equivalent within {100 * margin:.0f}")
    row["loss"] = f"{100 * loss.value:+.1f} [{100 * ends.low:.1f}, {100 * ends.high:.1f}]"
    row["verdict"] = ", ".join(verdicts) or "neither shown"
    return row


def _share(count: int, total: int) -> str:
    interval = wilson_interval(count, total)
    assert interval is not None
    return f"{100 * count / total:.1f} % [{100 * interval.low:.0f}, {100 * interval.high:.0f}]"
