"""Whether policies keep their success when their answers take as long as a budget allows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import pandas as pd

from robogauntlet.results.record import Status
from robogauntlet.results.statistics.pairs import MARGIN, Pairs, is_no_worse, paired_difference
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.suites.axes import AXES, LATENCY
from robogauntlet.suites.episode import CLEAN

COLUMNS = ("policy", "task", "seed", "axis", "severity", "status")
"""Fields of the record that are needed."""


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """A policy at the latency of the budget, against its clean episodes of the same tasks and seeds."""

    policy: str
    mode: str
    """What the robot does meanwhile: a `TimingMode`."""
    trials: int
    clean: int
    """Successes without latency."""
    late: int
    """Successes with it."""
    change: Estimate | None
    """Late minus clean rate, with Newcombe's paired interval."""
    is_kept: bool
    """Whether less than the margin is shown to be lost."""


def latencies_in(rows: pd.DataFrame) -> list[float]:
    """The latencies of the axes of latency that were played (ms)."""
    played = rows[rows["axis"].isin(list(LATENCY))][["axis", "severity"]].drop_duplicates()
    return sorted({AXES[str(axis)].value(int(severity)) for axis, severity in played.itertuples(index=False)})


def within_budget(rows: pd.DataFrame, latency_ms: float, margin: float = MARGIN) -> Iterator[BudgetRow]:
    """Test each policy in each mode that was played at this latency.

    Args:
        rows: A row per episode, with the columns `COLUMNS`; errors count on neither side.
        latency_ms: One of `latencies_in`.
        margin: Loss of success below which it counts as kept.
    """
    won = rows.assign(won=rows["status"].map({str(Status.SUCCESS): 1.0, str(Status.FAILURE): 0.0}).astype(float))
    for policy, own in won.groupby("policy", sort=False, observed=True):
        clean = own[own["axis"] == CLEAN]
        for axis, mode in LATENCY.items():
            levels = [level for level in range(1, 6) if AXES[axis].value(level) == latency_ms]
            late = own[(own["axis"] == axis) & own["severity"].isin(levels)]
            if late.empty:
                continue
            both = clean.merge(late, on=["task", "seed"], suffixes=("", "_late"))
            pairs = Pairs.from_outcomes(both["won_late"].to_numpy(), both["won"].to_numpy())
            change, is_kept = paired_difference(pairs), is_no_worse(pairs, margin)
            yield BudgetRow(str(policy), str(mode), pairs.trials, pairs.second, pairs.first, change, is_kept)
