"""Robust experts beside the zoo's under all axes at severities 2 and 4.

`ROBUST=FOLDER python -m studies robust_experts --measure robust_experts` reads two runs of
`studies/robust_experts/robust_experts.sh` (default `runs/robust-experts`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from robogauntlet.results.analysis.eligible_episodes import select_eligible
from robogauntlet.results.api import open_run
from robogauntlet.results.report.formatting import points
from robogauntlet.results.run_document import read_run
from robogauntlet.results.statistics.aggregate import Estimate, mean_of_levels
from robogauntlet.results.statistics.rates import Interval
from robogauntlet.suites.episode import CLEAN
from studies.percent import folder_of
from studies.shared import table_of
from studies.tables import write_episodes

FAMILIES = ("zoo", "robust")
EXPERTS, ORACLE = "experts", "oracle"
SEVERITIES = (2, 4)
TRAINED_ON = (
    *("camera-orbit", "camera-distance", "field-of-view", "light-direction", "illuminance", "colour-temperature"),
    *("table", "distractors", "object-position", "robot-start"),
)
"""Axes along which the scenes of the demonstrations vary."""
EVERY, SCENES, OTHERS = "all 18 axes", "10 axes of the scenes", "7 other axes"
WORDS = "instruction"
"""Training changes words, but in another way than this axis."""
EPISODE = ("policy", "task", "axis", "severity", "seed", "status")
"""Columns of an episode, beside `family`."""


def measure() -> list[dict[str, object]]:
    """A row for each axis and for groups of them; writes the episodes beside the rows."""
    frame = played()
    write_episodes("robust_experts", frame, ("family", *EPISODE[:5]))
    rows = rows_of(frame)
    table_of(rows, columns_of("zoo", "zoo's"))
    return rows


def columns_of(baseline: str, title: str) -> dict[str, str]:
    """The columns of a table whose rows are those of `compared`, beside robust experts."""
    sides = {title: baseline, "robust": "robust", "difference (points) [95 %]": "difference"}
    return {"condition": "{name}", "episodes each": "{episodes}"} | {
        f"{text}, severity {severity}": f"{{{key}{severity}}}" for severity in SEVERITIES for text, key in sides.items()
    }


def played() -> pd.DataFrame:
    """Both families' `episodes_of`, with the column `family`."""
    return pd.concat([episodes_of(family).assign(family=family) for family in FAMILIES], ignore_index=True)


def episodes_of(run: str) -> pd.DataFrame:
    """The episodes of a run that count, with the columns `EPISODE`, without the oracle's."""
    folder = folder_of("ROBUST", "robust-experts") / "runs" / run
    frame, document = open_run(folder).episodes((*EPISODE, "policy_digest", "delivered")), read_run(folder)
    cells = [cell for cell in document.plan if cell.policy != ORACLE]
    kept = select_eligible(document, frame).verdicts(cells)[list(EPISODE)]
    return kept.astype(dict.fromkeys(("policy", "task", "axis", "status"), str))


def rows_of(frame: pd.DataFrame) -> list[dict[str, object]]:
    """Success of both families' experts and their difference; `frame` is that of `played`."""
    frame = frame[(frame.policy == EXPERTS) & frame.family.isin(FAMILIES)].assign(policy=lambda rows: rows.family)
    groups = groups_of(frame)
    for suffix, kind in (("", SCENES), (" (other)", OTHERS)):
        groups |= {f"{axis}{suffix}": [axis] for axis in groups[kind]}
    return [{"name": name} | compared(frame[frame.axis.isin(chosen)]) for name, chosen in groups.items()]


def groups_of(frame: pd.DataFrame) -> dict[str, list[str]]:
    """Name of each group of axes to its axes, sorted."""
    axes = [axis for axis in sorted(frame.axis.unique()) if axis not in (CLEAN, WORDS)]
    trained, others = ([axis for axis in axes if (axis in TRAINED_ON) is wanted] for wanted in (True, False))
    return {CLEAN: [CLEAN], EVERY: [*axes, WORDS], SCENES: trained, f"{WORDS} (words)": [WORDS], OTHERS: others}


def compared(frame: pd.DataFrame, families: Sequence[str] = FAMILIES) -> dict[str, object]:
    """Success of two families at each severity, and its difference, levels and tasks having equal weight.

    `frame` has the families as policies. Intervals are Student's, for other start states.
    """
    row: dict[str, object] = {}
    counts = []
    for severity in SEVERITIES:
        strata = paired(frame[frame.severity.isin((0, severity))], families)
        row |= dict.fromkeys((*(f"{one}{severity}" for one in families), f"difference{severity}"), "")
        if strata:  # the oracle succeeds in a task
            sides = [[np.hsplit(one, 2)[side] for one in strata] for side in (0, 1)]
            rates = [mean_of_levels(side) for side in sides]
            gain = mean_of_levels([after - before for before, after in zip(*sides, strict=True)])
            for one, rate in zip(families, rates, strict=True):
                assert rate
                row[f"{one}{severity}"] = f"{int(100 * rate.value + 0.5 + 1e-9)}%"  # a half, on any processor
            row[f"difference{severity}"] = points(_possible(gain))
            counts.append(sum(int((~np.isnan(one)).sum()) for one in sides[0]))
    return row | {"episodes": " / ".join(map(str, dict.fromkeys(counts)))}


def _possible(gain: Estimate | None) -> Estimate | None:
    """A difference of rates whose interval ends where differences do, at 100 points."""
    if gain is None or gain.interval is None:
        return gain
    return replace(gain, interval=Interval(max(gain.interval.low, -1.0), min(gain.interval.high, 1.0)))


def paired(frame: pd.DataFrame, policies: Sequence[str]) -> list[np.ndarray]:
    """Success on common episodes: per task, shape (seeds, policies x levels), NaN where one is missing."""
    won = frame[frame.policy.isin(policies)].assign(won=lambda rows: (rows.status == "success").astype(float))
    levels = sorted(set(zip(won.axis, won.severity, strict=True)))
    columns = [(policy, *level) for policy in policies for level in levels]
    found = []
    for _, own in won.groupby("task") if levels else ():
        wide = own.pivot(index="seed", columns=["policy", "axis", "severity"], values="won").reindex(
            columns=pd.MultiIndex.from_tuples(columns)
        )
        sides = np.stack(np.hsplit(wide.to_numpy(), len(policies)))
        found.append(np.hstack([*np.where(np.isnan(sides).any(axis=0), np.nan, sides)]))
    return found
