"""How success falls with severity along each axis, and what of each severity was delivered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from results.judging import GateRow, Judged, judge
from results.overall import Overall, build_overall
from results.record import Status
from results.run import PlannedCell, RunDocument, Unsupported
from results.shift import Shift, build_shift
from results.statistics.aggregate import mean_outcomes
from results.statistics.rates import Estimate
from results.statistics.severity import SeverityCurve, severity_curve
from suites.axes import AXES
from suites.vocabulary import CLEAN, CONTROLS, content_hash

if TYPE_CHECKING:
    import pandas as pd

AGAIN = "again"
"""The control that plays the clean episodes once more."""
COLUMNS = (
    *("simulator", "task", "policy_digest", "axis", "severity", "seed", "status"),
    *("state_hash", "actions_hash", "final_state_hash", "delivered", "inferred_task"),
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
    episodes: tuple[int, ...]
    """With a verdict that counts, at each level."""
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
class Repeats:
    """Whether episodes played twice ended alike (A/A)."""

    simulator: str
    episodes: int
    """Clean episodes that were played again, by all policies."""
    alike: int
    """Those of them with the same actions and the same final state, to the bit."""


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
    repeats: tuple[Repeats, ...] = ()
    shift: Shift | None = None
    """Policies against each other, if the suite asks for it."""
    floors: tuple[str, ...] = ()
    """Policies whose success is taken off, at every level, from those that what is kept is a share of."""
    overall: Overall | None = None
    """All axes together."""


def is_perturbed(document: RunDocument) -> bool:
    """Whether a run plans anything but the clean condition."""
    return any(cell.axis != CLEAN for cell in document.plan)


def build_robustness(document: RunDocument, frame: pd.DataFrame) -> Robustness:
    """Curves, controls and delivered values of a run.

    Args:
        document: The run.
        frame: `COLUMNS` of its rows.
    """
    named = dict.fromkeys(cell.axis for cell in document.plan if cell.axis != CLEAN)
    axes = tuple(name for name in named if name not in CONTROLS)
    judged = judge(document, frame)
    policies = [policy for policy in dict.fromkeys(cell.policy for cell in document.plan) if policy != document.gate]
    places = [
        (policy, simulator, axis, planned)
        for axis in named
        for policy in policies
        for planned in [[c for c in document.plan if c.policy == policy and c.axis in (axis, CLEAN)]]
        for simulator in _places(planned)
    ]
    floors = {name: [c for c in document.plan if c.policy == name] for name in document.floors}
    curves = [_curve(*place, judged, [] if place[0] in floors else list(floors.values())) for place in places]
    found = [curve for curve in curves if curve is not None]
    return Robustness(
        axes,
        tuple(curve for curve in found if curve.axis in axes),
        tuple(_control(curve) for curve in found if curve.axis not in (*axes, AGAIN)),
        document.gate,
        tuple(row for row in judged.gated if row.passed < row.seeds),
        _delivered(axes, frame),
        _worlds(frame),
        document.unsupported,
        _repeats(frame),
        build_shift(document, judged),
        document.floors,
        build_overall(document, judged),
    )


def _places(planned: Sequence[PlannedCell]) -> tuple[str | None, ...]:
    """All simulators together, if there are several, then each."""
    simulators = tuple(dict.fromkeys(cell.simulator for cell in planned))
    return (None, *simulators) if len(simulators) > 1 else simulators


def _control(found: PolicyCurve) -> ControlRow:
    curve = found.curve
    return ControlRow(found.policy, found.simulator, found.axis, curve.rates[0], curve.rates[1], curve.drops[1])


def _curve(
    policy: str,
    simulator: str | None,
    axis: str,
    planned: Sequence[PlannedCell],
    judged: Judged,
    floors: Sequence[Sequence[PlannedCell]],
) -> PolicyCurve | None:
    """None where there is no clean episode, or nothing else."""
    cells = [cell for cell in planned if simulator in (None, cell.simulator)]
    levels = sorted({cell.severity for cell in cells})
    strata = judged.outcomes(cells, levels)
    if len(levels) < 2 or levels[0] != 0 or not strata:
        return None
    generator = np.random.default_rng(int(content_hash([policy, simulator, axis]), 16))
    curve = severity_curve(strata, levels, generator, floors=_floor(cells, levels, judged, floors))
    episodes = tuple(sum(int((outcomes[:, i] >= 0).sum()) for outcomes in strata) for i in range(len(levels)))
    return PolicyCurve(policy, simulator, axis, len(strata), max(map(len, strata)), episodes, curve)


def _floor(
    cells: Sequence[PlannedCell], levels: Sequence[int], judged: Judged, floors: Sequence[Sequence[PlannedCell]]
) -> list[float] | None:
    """At each level the success of the best of the policies without skill, in the same tasks."""
    here = {(cell.task, cell.axis) for cell in cells}
    strata = [judged.outcomes([c for c in cells if (c.task, c.axis) in here], levels) for cells in floors]
    means = [np.ma.masked_invalid(mean_outcomes(found)).mean(axis=0).filled(0.0) for found in strata if found]
    return np.max(means, axis=0).tolist() if means else None


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


def _repeats(frame: pd.DataFrame) -> tuple[Repeats, ...]:
    keys = ["simulator", "task", "policy_digest", "seed"]
    ends = ["actions_hash", "final_state_hash"]
    played = frame[frame["status"] != str(Status.ERROR)].astype(dict.fromkeys([*keys[:3], *ends], str))
    once, again = (played[played["axis"] == axis].set_index(keys)[ends] for axis in (CLEAN, AGAIN))
    both = once.join(again, rsuffix="_again", how="inner")
    alike = (both[ends].to_numpy() == both[[f"{end}_again" for end in ends]].to_numpy()).all(axis=1)
    counts = both.assign(alike=alike).groupby("simulator")["alike"].agg(["count", "sum"])
    return tuple(Repeats(str(name), int(count), int(same)) for name, count, same in counts.itertuples())


def _worlds(frame: pd.DataFrame) -> Worlds:
    played = frame[frame["status"] != str(Status.ERROR)]
    clean = played[played["axis"] == CLEAN].groupby(["task", "seed"], observed=True)["state_hash"].first()
    clean_start = [name for name, axis in AXES.items() if axis.changes.starts_clean]
    other = played[played["axis"].isin(clean_start)]
    joined = other.join(clean.rename("clean"), on=["task", "seed"], how="inner")
    return Worlds(len(joined), int((joined["state_hash"] != joined["clean"]).sum()))
