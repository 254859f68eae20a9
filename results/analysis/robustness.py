"""Success by severity along each axis, controls, and the perturbations that were delivered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robogauntlet.results.analysis import eligible_episodes as eligibility
from robogauntlet.results.analysis.condition_comparison import ConditionComparison, compare_conditions
from robogauntlet.results.analysis.eligible_episodes import EligibleEpisodes, GateRow
from robogauntlet.results.analysis.robustness_summary import RobustnessSummary, build_robustness_summary
from robogauntlet.results.record import Status
from robogauntlet.results.run_document import PlannedCell, RunDocument, Unsupported
from robogauntlet.results.statistics.aggregate import mean_outcomes
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.results.statistics.severity import SeverityCurve, severity_curve
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CLEAN, CONTROLS

if TYPE_CHECKING:
    import pandas as pd

AGAIN = "again"
"""The control that repeats the clean episodes."""
COLUMNS = (
    *("simulator", "task", "policy_digest", "axis", "severity", "seed", "status"),
    *("state_hash", "actions_hash", "final_state_hash", "delivered", "inferred_task"),
)
"""Fields of the record that are needed."""


@dataclass(frozen=True, slots=True)
class DeliveredCell:
    """Delivered value in one simulator, over the episodes in which it was measured."""

    simulator: str
    episodes: int
    mean: float
    low: float
    """Smallest value of an episode."""
    high: float
    undelivered: int = 0
    """Episodes in which the axis changed nothing; they count in no rate."""


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
        """Range of the simulators' means relative to the requested value; None for a single simulator."""
        means = [cell.mean for cell in self.simulators]
        return (max(means) - min(means)) / abs(self.asked) if len(means) > 1 else None


@dataclass(frozen=True, slots=True)
class PolicyCurve:
    """One policy along one axis, in one simulator or all."""

    policy: str
    simulator: str | None
    """None for all simulators; tasks have equal weight."""
    axis: str
    tasks: int
    seeds: int
    """Largest number of seeds of a task."""
    episodes: tuple[int, ...]
    """Number of episodes that count at each level."""
    curve: SeverityCurve


@dataclass(frozen=True, slots=True)
class ControlRow:
    """One policy under one control, in one simulator or all."""

    policy: str
    simulator: str | None
    control: str
    clean: Estimate
    rate: Estimate
    drop: Estimate
    """Clean minus control, on the same seeds."""


@dataclass(frozen=True, slots=True)
class Repeats:
    """Comparison of repeated clean episodes (A/A)."""

    simulator: str
    episodes: int
    """Clean episodes that were repeated, of all policies."""
    identical: int
    """Those with bit-identical actions and final state."""


@dataclass(frozen=True, slots=True)
class StartStates:
    """Comparison of start states with those of the clean episodes, on axes that do not change them."""

    compared: int
    """Episodes whose clean episode has a row."""
    differing: int
    """Episodes that started from another physical state."""


@dataclass(frozen=True, slots=True)
class GatedPolicy:
    """Perturbed episodes of one policy, with and without the oracle gate; controls and combinations apart."""

    policy: str
    episodes: int
    successes: int
    counted: int
    """Episodes that the gate lets count."""
    counted_successes: int


@dataclass(frozen=True, slots=True)
class Robustness:
    """All results under perturbations."""

    axes: tuple[str, ...]
    """In the order of the plan."""
    curves: tuple[PolicyCurve, ...]
    """By axis, then policy; the curve over all simulators comes first."""
    controls: tuple[ControlRow, ...]
    oracle_gate: str | None
    """Policy that must solve an episode for it to count."""
    gate_rows: tuple[GateRow, ...]
    """Conditions in which it did not solve every seed."""
    gated: tuple[GatedPolicy, ...]
    """Empty if it solved every seed."""
    delivered: tuple[DeliveredRow, ...]
    start_states: StartStates
    unsupported: tuple[Unsupported, ...] = ()
    """Combinations of axis and task that could not be planned."""
    repeats: tuple[Repeats, ...] = ()
    condition_comparison: ConditionComparison | None = None
    """Comparison of policies under perturbations, if the suite asks for it."""
    no_skill_baselines: tuple[str, ...] = ()
    """Policies whose success is subtracted at every level before retention is computed."""
    summary: RobustnessSummary | None = None
    """All axes together."""


def is_perturbed(document: RunDocument) -> bool:
    """Whether a run plans any condition except clean."""
    return any(cell.axis != CLEAN for cell in document.plan)


def build_robustness(document: RunDocument, frame: pd.DataFrame) -> Robustness:
    """Compute the robustness results of a run from its rows with the columns `COLUMNS`."""
    perturbed = [cell for cell in document.plan if cell.axis != CLEAN and not cell.condition.is_combination]
    named = dict.fromkeys(cell.axis for cell in perturbed)
    axes = tuple(name for name in named if name not in CONTROLS)
    of_axes = [cell for cell in perturbed if cell.axis in axes]
    eligible = eligibility.select_eligible(document, frame)
    baselines = {name: [c for c in document.plan if c.policy == name] for name in document.suite.no_skill_baselines}
    known: list[PolicyCurve] = []
    for axis in named:
        for policy in dict.fromkeys(c.policy for c in document.plan if c.policy != document.suite.oracle_gate):
            planned = [c for c in document.plan if c.policy == policy and c.axis in (axis, CLEAN)]
            subtracted = [] if policy in baselines else list(baselines.values())
            simulators = tuple(dict.fromkeys(cell.simulator for cell in planned))
            places = (None, *simulators) if len(simulators) > 1 else simulators
            curves = (_curve(policy, place, axis, planned, eligible, subtracted) for place in places)
            known += [curve for curve in curves if curve is not None]
    controls = [
        ControlRow(row.policy, row.simulator, row.axis, row.curve.rates[0], row.curve.rates[1], row.curve.drops[1])
        for row in known
        if row.axis not in (*axes, AGAIN)
    ]
    gate_rows = tuple(row for row in eligible.gate_rows if row.passed < row.seeds)
    measured = dict.fromkeys(c.policy for c in of_axes if c.policy not in (document.suite.oracle_gate, *baselines))
    return Robustness(
        axes,
        tuple(curve for curve in known if curve.axis in axes),
        tuple(controls),
        document.suite.oracle_gate,
        gate_rows,
        tuple(_gated(name, [c for c in of_axes if c.policy == name], eligible) for name in measured if gate_rows),
        _delivered(axes, frame),
        _start_states(frame),
        document.unsupported,
        _repeats(frame),
        compare_conditions(document, eligible),
        document.suite.no_skill_baselines,
        build_robustness_summary(document, eligible),
    )


def _gated(policy: str, cells: Sequence[PlannedCell], eligible: EligibleEpisodes) -> GatedPolicy:
    played = [status for cell in cells for status in eligible.rows.of_cell(cell)["status"]]
    counted = [*eligible.verdicts(cells)["status"]]
    won = [statuses.count(str(Status.SUCCESS)) for statuses in (played, counted)]
    return GatedPolicy(policy, len(played), won[0], len(counted), won[1])


def _curve(
    policy: str,
    simulator: str | None,
    axis: str,
    planned: Sequence[PlannedCell],
    eligible: EligibleEpisodes,
    baselines: Sequence[Sequence[PlannedCell]],
) -> PolicyCurve | None:
    """None without clean episodes or without perturbed ones."""
    cells = [cell for cell in planned if simulator in (None, cell.simulator)]
    levels = sorted({cell.severity for cell in cells})
    strata = eligible.outcomes(cells, levels)
    if len(levels) < 2 or levels[0] != 0 or not strata:
        return None
    ordered = axis not in AXES or AXES[axis].ordered
    subtracted = _no_skill_rates(cells, levels, eligible, baselines)
    curve = severity_curve(strata, levels, baselines=subtracted, ordered=ordered)
    episodes = tuple(sum(int((outcomes[:, i] >= 0).sum()) for outcomes in strata) for i in range(len(levels)))
    return PolicyCurve(policy, simulator, axis, len(strata), max(map(len, strata)), episodes, curve)


def _no_skill_rates(
    cells: Sequence[PlannedCell],
    levels: Sequence[int],
    eligible: EligibleEpisodes,
    baselines: Sequence[Sequence[PlannedCell]],
) -> list[float] | None:
    """Highest success of a no-skill baseline at each level, in the same tasks."""
    tasks = {(cell.task, cell.axis) for cell in cells}
    strata = [eligible.outcomes([c for c in cells if (c.task, c.axis) in tasks], levels) for cells in baselines]
    means = [np.ma.masked_invalid(mean_outcomes(outcomes)).mean(axis=0).filled(0.0) for outcomes in strata if outcomes]
    return np.max(means, axis=0).tolist() if means else None


def _delivered(axes: Sequence[str], frame: pd.DataFrame) -> tuple[DeliveredRow, ...]:
    measured = frame[frame["delivered"].notna()]
    groups = measured.assign(nothing=eligibility.is_undelivered(measured)).groupby(
        ["axis", "severity", "simulator"], observed=True
    )
    found = groups["delivered"].agg(["count", "mean", "min", "max"]).join(groups["nothing"].sum())
    cells: dict[tuple[str, int], list[DeliveredCell]] = {}
    for (axis, severity, simulator), (count, mean, low, high, nothing) in zip(
        found.index, found.to_numpy(), strict=True
    ):
        cell = DeliveredCell(str(simulator), int(count), float(mean), float(low), float(high), int(nothing))
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
    both = once.join(again.add_suffix("_again"), how="inner")
    identical = (both[ends].to_numpy() == both[[f"{end}_again" for end in ends]].to_numpy()).all(axis=1)
    counts = both.assign(identical=identical).groupby("simulator")["identical"].agg(["count", "sum"])
    return tuple(Repeats(str(name), int(count), int(same)) for name, count, same in counts.itertuples())


def _start_states(frame: pd.DataFrame) -> StartStates:
    played = frame[frame["status"] != str(Status.ERROR)]
    clean = played[played["axis"] == CLEAN].groupby(["task", "seed"], observed=True)["state_hash"].first()
    clean_start = [name for name, axis in AXES.items() if axis.changes.starts_clean]
    other = played[played["axis"].isin(clean_start)]
    joined = other.join(clean.rename("clean"), on=["task", "seed"], how="inner")
    return StartStates(len(joined), int((joined["state_hash"] != joined["clean"]).sum()))
