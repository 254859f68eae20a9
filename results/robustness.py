"""How success falls with severity along each axis, and what of each severity was delivered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from results.record import Status
from results.run import PlannedCell, RunDocument
from results.statistics.aggregate import Outcomes
from results.statistics.severity import SeverityCurve, severity_curve
from suites.axes import AXES
from suites.vocabulary import CLEAN, content_hash

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    *("simulator", "task", "policy_digest", "axis", "severity", "seed", "status"),
    *("state_hash", "delivered"),
)
"""Fields of the record that are needed."""


@dataclass(frozen=True, slots=True)
class DeliveredCell:
    """What one simulator delivered, over the episodes in which it was measured."""

    simulator: str
    episodes: int
    mean: float
    low: float
    """The least of an episode."""
    high: float


@dataclass(frozen=True, slots=True)
class DeliveredRow:
    """One severity of one axis, simulator by simulator."""

    axis: str
    severity: int
    asked: float
    unit: str
    simulators: tuple[DeliveredCell, ...]

    @property
    def spread(self) -> float | None:
        """Distance of the simulators' means as a share of what was asked for; None for a single simulator."""
        means = [cell.mean for cell in self.simulators]
        return (max(means) - min(means)) / abs(self.asked) if len(means) > 1 else None


@dataclass(frozen=True, slots=True)
class PolicyCurve:
    """One policy along one axis, in one simulator or in all."""

    policy: str
    simulator: str | None
    """None for all simulators together; every task weighs the same."""
    axis: str
    tasks: int
    seeds: int
    """Most seeds that a task has."""
    curve: SeverityCurve


@dataclass(frozen=True, slots=True)
class Worlds:
    """Whether perturbed episodes started from the world of the clean ones."""

    compared: int
    """Perturbed episodes whose clean episode has a row too."""
    differing: int
    """Those that started from another physical state."""


@dataclass(frozen=True, slots=True)
class Robustness:
    """What a report says about perturbations."""

    axes: tuple[str, ...]
    """In the order of the plan."""
    curves: tuple[PolicyCurve, ...]
    """By axis, then policy; of each all simulators first."""
    delivered: tuple[DeliveredRow, ...]
    worlds: Worlds


def is_perturbed(document: RunDocument) -> bool:
    """Whether a run plans anything but the clean condition."""
    return any(cell.axis != CLEAN for cell in document.plan)


def build_robustness(document: RunDocument, frame: pd.DataFrame) -> Robustness:
    """Curves and delivered values of a run.

    Args:
        document: The run.
        frame: `COLUMNS` of its rows.
    """
    axes = tuple(dict.fromkeys(cell.axis for cell in document.plan if cell.axis != CLEAN))
    curves = []
    for axis in axes:
        for policy in dict.fromkeys(cell.policy for cell in document.plan):
            planned = [cell for cell in document.plan if cell.policy == policy and cell.axis in (axis, CLEAN)]
            simulators = dict.fromkeys(cell.simulator for cell in planned)
            curves += [
                _curve(policy, simulator, axis, planned, frame)
                for simulator in ((None, *simulators) if len(simulators) > 1 else tuple(simulators))
            ]
    return Robustness(axes, tuple(filter(None, curves)), _delivered(axes, frame), _worlds(frame))


def _curve(
    policy: str, simulator: str | None, axis: str, planned: Sequence[PlannedCell], frame: pd.DataFrame
) -> PolicyCurve | None:
    """None where there is no clean episode, or nothing else."""
    cells = [cell for cell in planned if simulator in (None, cell.simulator)]
    levels = sorted({cell.severity for cell in cells})
    strata = _outcomes(cells, levels, frame)
    if len(levels) < 2 or levels[0] != 0 or not strata:
        return None
    generator = np.random.default_rng(int(content_hash([policy, simulator, axis]), 16))
    curve = severity_curve(strata, levels, generator)
    return PolicyCurve(policy, simulator, axis, len(strata), max(map(len, strata)), curve)


def _outcomes(cells: Sequence[PlannedCell], levels: Sequence[int], frame: pd.DataFrame) -> list[Outcomes]:
    """Success of each task's seeds at each level, shape (seeds, levels), tasks without any verdict left out."""
    strata = []
    for task in dict.fromkeys(cell.task for cell in cells):
        own = [cell for cell in cells if cell.task == task]
        digest, axes = own[0].policy_digest, {cell.axis for cell in own}
        rows = frame[(frame["task"] == task) & (frame["policy_digest"] == digest) & frame["axis"].isin(axes)]
        rows = rows[rows["status"] != str(Status.ERROR)]
        if not len(rows):
            continue
        won = (rows["status"] == str(Status.SUCCESS)).astype(float)
        table = won.groupby([rows["seed"], rows["severity"]]).first().unstack()
        strata.append(table.reindex(columns=list(levels)).to_numpy(dtype=float))
    return strata


def _delivered(axes: Sequence[str], frame: pd.DataFrame) -> tuple[DeliveredRow, ...]:
    measured = frame[frame["delivered"].notna()]
    groups = measured.groupby(["axis", "severity", "simulator"], observed=True)["delivered"]
    found = groups.agg(["count", "mean", "min", "max"])
    cells: dict[tuple[str, int], list[DeliveredCell]] = {}
    for (axis, severity, simulator), (count, mean, low, high) in zip(found.index, found.to_numpy(), strict=True):
        cell = DeliveredCell(str(simulator), int(count), float(mean), float(low), float(high))
        cells.setdefault((str(axis), int(severity)), []).append(cell)
    return tuple(
        DeliveredRow(axis, severity, AXES[axis].value(severity), AXES[axis].unit, tuple(cells[axis, severity]))
        for axis in axes
        for severity in sorted(s for a, s in cells if a == axis)
        if axis in AXES
    )


def _worlds(frame: pd.DataFrame) -> Worlds:
    played = frame[frame["status"] != str(Status.ERROR)]
    clean = played[played["axis"] == CLEAN].groupby(["task", "seed"], observed=True)["state_hash"].first()
    other = played[played["axis"] != CLEAN]
    joined = other.join(clean.rename("clean"), on=["task", "seed"], how="inner")
    return Worlds(len(joined), int((joined["state_hash"] != joined["clean"]).sum()))
