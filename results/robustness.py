"""How success falls with severity along each axis, and what of each severity was delivered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from results.record import Status
from results.run import PlannedCell, RunDocument, Unsupported
from results.statistics.aggregate import Outcomes
from results.statistics.rates import Estimate
from results.statistics.severity import SeverityCurve, severity_curve
from suites.axes import AXES
from suites.vocabulary import CLEAN, CONTROLS, content_hash

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    *("simulator", "task", "policy_digest", "axis", "severity", "seed", "status"),
    *("state_hash", "delivered"),
)
"""Fields of the record that are needed."""
LEAST_SOLVED = 0.95
"""Share of the seeds that the gate must solve at a level; below, the level says nothing about the task."""


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
class ControlRow:
    """One policy under one control, in one simulator or in all."""

    policy: str
    simulator: str | None
    control: str
    clean: Estimate
    rate: Estimate
    drop: Estimate
    """Clean minus control, on the same seeds."""


@dataclass(frozen=True, slots=True)
class GateRow:
    """What the gate let pass of one task under one condition."""

    task: str
    axis: str
    severity: int
    seeds: int
    """With a verdict of the gate."""
    passed: int
    capped: bool
    """Too few passed: the level says nothing about this task."""


@dataclass(frozen=True, slots=True)
class Worlds:
    """Whether episodes started from the world of the clean ones, on axes that do not move anything."""

    compared: int
    """Those whose clean episode has a row too."""
    differing: int
    """Those that started from another physical state."""


@dataclass(frozen=True, slots=True)
class Robustness:
    """What a report says about perturbations."""

    axes: tuple[str, ...]
    """In the order of the plan."""
    curves: tuple[PolicyCurve, ...]
    """By axis, then policy; of each all simulators first."""
    controls: tuple[ControlRow, ...]
    gate: str | None
    """Policy that must solve an episode for it to count."""
    gated: tuple[GateRow, ...]
    """Conditions in which it did not solve everything."""
    delivered: tuple[DeliveredRow, ...]
    worlds: Worlds
    unsupported: tuple[Unsupported, ...] = ()
    """What of the suite could not be planned."""


def is_perturbed(document: RunDocument) -> bool:
    """Whether a run plans anything but the clean condition."""
    return any(cell.axis != CLEAN for cell in document.plan)


Rejected = Mapping[tuple[str, str], Set[int]]


@dataclass(frozen=True, eq=False)
class _Judged:
    """Rows, and what of them does not count."""

    frame: pd.DataFrame
    rejected: Rejected
    capped: Set[tuple[str, str, int]]

    def outcomes(self, cells: Sequence[PlannedCell], levels: Sequence[int]) -> list[Outcomes]:
        """Success of each task's seeds at each level, shape (seeds, levels), tasks without any verdict left out.

        Args:
            cells: Of one policy under one axis and the clean condition.
            levels: Severities.
        """
        strata = []
        for task in dict.fromkeys(cell.task for cell in cells):
            own = [cell for cell in cells if cell.task == task]
            rows = _together([_verdicts(self.frame, cell) for cell in own if not self._is_capped(cell)])
            out = set().union(*(self.rejected.get((task, axis), ()) for axis in {cell.axis for cell in own}))
            rows = rows[~rows["seed"].isin(out)]
            if not len(rows):
                continue
            won = (rows["status"] == str(Status.SUCCESS)).astype(float)
            table = won.groupby([rows["seed"], rows["severity"]]).first().unstack()
            strata.append(table.reindex(columns=list(levels)).to_numpy(dtype=float))
        return strata

    def _is_capped(self, cell: PlannedCell) -> bool:
        return (cell.task, cell.axis, cell.severity) in self.capped


def build_robustness(document: RunDocument, frame: pd.DataFrame) -> Robustness:
    """Curves, controls and delivered values of a run.

    Args:
        document: The run.
        frame: `COLUMNS` of its rows.
    """
    named = dict.fromkeys(cell.axis for cell in document.plan if cell.axis != CLEAN)
    axes = tuple(name for name in named if name not in CONTROLS)
    gated = _gated(document, frame)
    rejected = _rejected(document, frame, gated)
    capped = {(row.task, row.axis, row.severity) for row in gated if row.capped}
    policies = [policy for policy in dict.fromkeys(cell.policy for cell in document.plan) if policy != document.gate]
    places = [
        (policy, simulator, axis, planned)
        for axis in named
        for policy in policies
        for planned in [[c for c in document.plan if c.policy == policy and c.axis in (axis, CLEAN)]]
        for simulator in _places(planned)
    ]
    curves = [_curve(*place, _Judged(frame, rejected, capped)) for place in places]
    found = [curve for curve in curves if curve is not None]
    return Robustness(
        axes,
        tuple(curve for curve in found if curve.axis in axes),
        tuple(_control(curve) for curve in found if curve.axis not in axes),
        document.gate,
        tuple(row for row in gated if row.passed < row.seeds),
        _delivered(axes, frame),
        _worlds(frame),
        document.unsupported,
    )


def _places(planned: Sequence[PlannedCell]) -> tuple[str | None, ...]:
    """All simulators together, if there are several, then each."""
    simulators = tuple(dict.fromkeys(cell.simulator for cell in planned))
    return (None, *simulators) if len(simulators) > 1 else simulators


def _gated(document: RunDocument, frame: pd.DataFrame) -> tuple[GateRow, ...]:
    """What the gate solved, condition by condition; controls are not meant to be solved."""
    rows = []
    for cell in document.plan:
        if cell.policy == document.gate and cell.axis not in CONTROLS:
            won = _verdicts(frame, cell)["status"] == str(Status.SUCCESS)
            seeds, passed = len(won), int(won.sum())
            capped = cell.axis != CLEAN and seeds > 0 and passed < LEAST_SOLVED * seeds
            rows.append(GateRow(cell.task, cell.axis, cell.severity, seeds, passed, capped))
    return tuple(rows)


def _rejected(document: RunDocument, frame: pd.DataFrame, gated: Sequence[GateRow]) -> Rejected:
    """(task, axis) to the seeds that the gate did not solve under the clean condition or at a level that counts.

    They are left out at every level and for all policies alike: else a level would be compared with the clean
    episodes of other seeds.
    """
    capped = {(row.task, row.axis, row.severity) for row in gated if row.capped}
    rejected: dict[tuple[str, str], set[int]] = {}
    for cell in document.plan:
        if cell.policy != document.gate or cell.axis in CONTROLS or (cell.task, cell.axis, cell.severity) in capped:
            continue
        rows = _verdicts(frame, cell)
        unsolved = rows[rows["status"] != str(Status.SUCCESS)]["seed"]
        rejected.setdefault((cell.task, cell.axis), set()).update(unsolved.tolist())
    return rejected


def _verdicts(frame: pd.DataFrame, cell: PlannedCell) -> pd.DataFrame:
    """A cell's rows that are successes or failures."""
    here = (frame["task"] == cell.task) & (frame["policy_digest"] == cell.policy_digest)
    here &= (frame["axis"] == cell.axis) & (frame["severity"] == cell.severity)
    return frame[here & (frame["status"] != str(Status.ERROR))]


def _together(frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    import pandas as pd

    return pd.concat(frames)


def _control(found: PolicyCurve) -> ControlRow:
    curve = found.curve
    return ControlRow(found.policy, found.simulator, found.axis, curve.rates[0], curve.rates[1], curve.drops[1])


def _curve(
    policy: str, simulator: str | None, axis: str, planned: Sequence[PlannedCell], judged: _Judged
) -> PolicyCurve | None:
    """None where there is no clean episode, or nothing else."""
    cells = [cell for cell in planned if simulator in (None, cell.simulator)]
    levels = sorted({cell.severity for cell in cells})
    strata = judged.outcomes(cells, levels)
    if len(levels) < 2 or levels[0] != 0 or not strata:
        return None
    generator = np.random.default_rng(int(content_hash([policy, simulator, axis]), 16))
    curve = severity_curve(strata, levels, generator)
    return PolicyCurve(policy, simulator, axis, len(strata), max(map(len, strata)), curve)


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
    clean_start = [name for name, axis in AXES.items() if axis.changes.starts_clean]
    other = played[played["axis"].isin(clean_start)]
    joined = other.join(clean.rename("clean"), on=["task", "seed"], how="inner")
    return Worlds(len(joined), int((joined["state_hash"] != joined["clean"]).sum()))
