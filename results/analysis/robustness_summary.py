"""Summary of a policy over all axes, and agreement of simulators on which axes reduce its success."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from robogauntlet.results.analysis.eligible_episodes import EligibleEpisodes
from robogauntlet.results.run_document import PlannedCell, RunDocument
from robogauntlet.results.statistics.aggregate import Outcomes, mean_outcomes
from robogauntlet.results.statistics.rank_agreement import kendall, rank_violation
from robogauntlet.suites.episode import CLEAN, Condition

LEAST_AXES = 3
"""Simulators are compared only on this number of axes or more."""


@dataclass(frozen=True, slots=True)
class SummaryRow:
    """One policy over all levels of all axes, in one simulator or all."""

    policy: str
    simulator: str | None
    """None for all simulators; tasks have equal weight."""
    conditions: int
    """Number of perturbed levels that count."""
    mean: float
    worst_axis: str
    """The axis with the lowest mean success; severities have equal weight."""
    worst: float
    """Its mean success; lower than its true one where axes are nearly alike, as the lowest of several is."""


@dataclass(frozen=True, slots=True)
class AgreementRow:
    """Agreement of two simulators on the order of axes by loss."""

    policy: str
    one: str
    other: str
    axes: int
    """Number of axes that both simulators have."""
    tau: float | None
    """Kendall's tau-b; chance pulls it towards 0. None if a simulator ties all axes."""
    p: float | None
    """One-sided, against independent orders; axes are treated as a sample."""
    violation: float
    """MMRV: mean over axes of the largest rank violation, as a success rate in the first simulator."""


@dataclass(frozen=True, slots=True)
class RobustnessSummary:
    """All axes together."""

    rows: tuple[SummaryRow, ...]
    agreement: tuple[AgreementRow, ...]


def build_robustness_summary(document: RunDocument, eligible: EligibleEpisodes) -> RobustnessSummary | None:
    """Summarise all axes for every policy except oracle gate and no-skill baselines; None without perturbed levels."""
    excluded = document.suite.reference_policies
    rows: list[SummaryRow] = []
    agreement: list[AgreementRow] = []
    for policy in dict.fromkeys(cell.policy for cell in document.plan if cell.policy not in excluded):
        cells = [
            cell
            for cell in document.plan
            if cell.policy == policy and (cell.axis == CLEAN or cell.condition.is_on_scale)
        ]
        outcomes = _PolicyOutcomes.select(policy, cells, eligible)
        if outcomes.levels and outcomes.tasks:
            rows += _rows(policy, outcomes)
            losses = {
                simulator: {axis: float(np.mean(lost)) for axis, lost in outcomes.by_axis(simulator, lost=True).items()}
                for simulator in outcomes.simulators
            }
            pairs = (_agreement(policy, *sides) for sides in combinations(losses.items(), 2))
            agreement += [row for row in pairs if row is not None]
    return RobustnessSummary(tuple(rows), tuple(agreement)) if rows else None


@dataclass(frozen=True, eq=False)
class _PolicyOutcomes:
    """Outcomes of one policy."""

    levels: tuple[Condition, ...]
    """Perturbed levels, in the order of the plan."""
    tasks: tuple[str, ...]
    strata: tuple[Outcomes, ...]
    """Per task, shape (seeds, 1 + levels): clean first, NaN where no episode counts."""

    @classmethod
    def select(cls, policy: str, cells: Sequence[PlannedCell], eligible: EligibleEpisodes) -> _PolicyOutcomes:
        levels = tuple(dict.fromkeys(cell.condition for cell in cells if cell.axis != CLEAN))
        found = eligible.by_condition(cells, (Condition(), *levels))
        return cls(levels, tuple(found), tuple(found.values()))

    def by_axis(self, simulator: str | None, *, lost: bool = False) -> dict[str, list[float]]:
        """Mean outcome at the levels of each axis over a simulator's tasks (None for all), or what is lost of clean."""
        own = [
            o for task, o in zip(self.tasks, self.strata, strict=True) if simulator in (None, task.partition("/")[0])
        ]
        means = mean_outcomes([outcomes[:, :1] - outcomes[:, 1:] if lost else outcomes[:, 1:] for outcomes in own])
        found: dict[str, list[float]] = {}
        for level, column in zip(self.levels, means.T, strict=True):
            if not np.isnan(column).all():
                found.setdefault(level.axis, []).append(float(np.nanmean(column)))
        return found

    @property
    def simulators(self) -> tuple[str, ...]:
        """Simulators of the tasks."""
        return tuple(dict.fromkeys(task.partition("/")[0] for task in self.tasks))


def _rows(policy: str, outcomes: _PolicyOutcomes) -> list[SummaryRow]:
    rows = []
    for simulator in (None, *outcomes.simulators) if len(outcomes.simulators) > 1 else outcomes.simulators:
        if by_axis := outcomes.by_axis(simulator):
            rates = [rate for levels in by_axis.values() for rate in levels]
            of_axis = {axis: float(np.mean(levels)) for axis, levels in by_axis.items()}
            worst = min(of_axis, key=of_axis.__getitem__)
            rows.append(SummaryRow(policy, simulator, len(rates), float(np.mean(rates)), worst, of_axis[worst]))
    return rows


def _agreement(policy: str, *sides: tuple[str, Mapping[str, float]]) -> AgreementRow | None:
    (one, ones), (other, others) = sides
    axes = [axis for axis in ones if axis in others]
    if len(axes) < LEAST_AXES:
        return None
    losses = [ones[axis] for axis in axes], [others[axis] for axis in axes]
    tau, p = kendall(*losses) or (None, None)
    return AgreementRow(policy, one, other, len(axes), tau, p, rank_violation(*losses))
