"""Comparison of policies under perturbations: success lost against a baseline, and accuracy of routers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.analysis.eligible_episodes import EligibleEpisodes
from robogauntlet.results.analysis.routing import Rate
from robogauntlet.results.record import Status
from robogauntlet.results.run_document import Decided, PlannedCell, RunDocument, RunStatus
from robogauntlet.results.statistics.aggregate import Outcomes, mean_of_levels
from robogauntlet.results.statistics.multiplicity import ALPHA, benjamini_hochberg
from robogauntlet.results.statistics.pairs import Pairs, mcnemar, paired_difference, pooled
from robogauntlet.results.statistics.rates import Estimate, Interval
from robogauntlet.results.statistics.sequential import paired_evidence
from robogauntlet.suites.episode import CLEAN
from robogauntlet.suites.schema import AdaptiveEntry


@dataclass(frozen=True, slots=True)
class LossRow:
    """Baseline minus another policy at one level, on seeds with a verdict of both."""

    policy: str
    """The other policy."""
    axis: str
    severity: int
    """0 for the clean condition."""
    pairs: int
    baseline: float
    """Rate of the baseline on the pairs."""
    rate: float
    """Rate of the other on the pairs."""
    loss: Estimate | None
    p: float
    """Exact McNemar, two-sided."""
    evidence: float
    """E-value, valid at any number of looks; 20 decides at 5 %."""
    adjusted: float
    """Benjamini-Hochberg over all levels and axes of this policy."""


@dataclass(frozen=True, slots=True)
class Interaction:
    """Loss of a policy against the baseline under an axis beyond its clean loss."""

    policy: str
    axis: str
    tasks: int
    extra: Estimate
    """Mean loss over the severities minus the clean loss; tasks have equal weight."""
    corrected: Interval | None
    """Simultaneous interval for all axes of this policy (Bonferroni)."""

    @property
    def is_shown(self) -> bool:
        """Whether the simultaneous interval excludes 0."""
        ends = self.corrected
        return ends is not None and (ends.low > 0 or ends.high < 0)


@dataclass(frozen=True, slots=True)
class Equivalence:
    """Loss of a policy against the baseline over all perturbed levels together, tested for equivalence."""

    policy: str
    levels: int
    pairs: int
    """Perturbed episodes with a verdict of both."""
    loss: Estimate
    """Mean over the levels, tasks having equal weight, with an interval of 1 - 2 `ALPHA`."""
    margin: float

    @property
    def is_shown(self) -> bool:
        """Whether the rates are shown to differ by less than the margin (two one-sided tests)."""
        ends = self.loss.interval
        return ends is not None and -self.margin < ends.low and ends.high < self.margin


@dataclass(frozen=True, slots=True)
class RouterRow:
    """Router accuracy of a policy at one level, over all simulators."""

    policy: str
    axis: str
    severity: int
    right: Rate
    """Episodes in which the task was inferred correctly."""
    success: Rate
    misrouted: Rate
    """Success in misrouted episodes."""


@dataclass(frozen=True, slots=True)
class Saving:
    """What a rule for stopping early did with the episodes of a suite, over all policies and tasks."""

    planned: int
    """Episodes that the suite has without the rule."""
    spared: int
    """Of them, those of conditions that were decided before."""
    given: int
    """Further episodes of conditions that were not decided, in place of spared ones."""

    @property
    def saved(self) -> int:
        """Spared episodes that were not played elsewhere."""
        return self.spared - self.given


@dataclass(frozen=True, slots=True)
class ConditionComparison:
    """The comparison of policies under perturbations."""

    baseline: str
    others: tuple[str, ...]
    losses: tuple[LossRow, ...]
    interactions: tuple[Interaction, ...]
    equivalences: tuple[Equivalence, ...]
    routers: tuple[RouterRow, ...]
    rule: AdaptiveEntry | None = None
    """The rule for stopping conditions early, if the suite has one."""
    decided: tuple[Decided, ...] = ()
    saving: Saving | None = None
    """Of a finished run with such a rule."""


def compare_conditions(document: RunDocument, eligible: EligibleEpisodes) -> ConditionComparison | None:
    """Make the comparison of the suite, from rows with the column `inferred_task`; None without one."""
    sides = document.suite.comparison
    if sides is None:
        return None
    axes = tuple(dict.fromkeys(c.axis for c in document.plan if c.condition.is_on_scale))
    losses, interactions, equivalences = [], [], []
    for policy in sides.others:
        rows: list[LossRow] = []
        for axis in axes:
            cells = [_cells(document, name, axis) for name in (sides.baseline, policy)]
            levels = sorted({cell.severity for cell in cells[0]} & {cell.severity for cell in cells[1]})
            levels, strata = _levels_with_verdicts(levels, eligible.paired(cells, levels))
            if len(levels) < 2 or levels[0] != 0 or not strata:
                continue
            rows += [row for row in _loss_rows(policy, axis, levels, strata) if row.severity or not rows]
            if (beyond := interaction(policy, axis, strata, len(axes))) is not None:
                interactions.append(beyond)
        adjusted = benjamini_hochberg([row.p for row in rows])
        losses += [replace(row, adjusted=p) for row, p in zip(rows, adjusted, strict=True)]
        if sides.margin is not None and document.suite.adaptive is None:  # it holds for a number of seeds fixed before
            strata = _perturbed(document, eligible, (sides.baseline, policy))
            if (overall := equivalence(policy, strata, sides.margin)) is not None:
                equivalences.append(overall)
    routers = [row for policy in sides.others for axis in axes for row in _routers(document, eligible, policy, axis)]
    found = (tuple(losses), tuple(interactions), tuple(equivalences), tuple(routers))
    return ConditionComparison(
        sides.baseline, sides.others, *found, document.suite.adaptive, document.decided, saving_of(document)
    )


def saving_of(document: RunDocument) -> Saving | None:
    """Return what stopping early did with the episodes of a complete run; None without such a rule."""
    if document.suite.adaptive is None or document.status is not RunStatus.COMPLETE:
        return None
    count = document.suite.seeds.count
    differences = [count - cell.planned for cell in document.plan]
    spared, given = sum(max(0, n) for n in differences), sum(max(0, -n) for n in differences)
    return Saving(count * len(document.plan), spared, given)


def _levels_with_verdicts(
    levels: Sequence[int], strata: Sequence[NDArray[np.floating]]
) -> tuple[list[int], list[NDArray[np.floating]]]:
    """Drop levels at which no pair has both verdicts, such as those that the oracle gate rejects in every task."""
    count = len(levels)
    kept = [i for i in range(count) if any((~np.isnan(s[:, i]) & ~np.isnan(s[:, count + i])).any() for s in strata)]
    return [levels[i] for i in kept], [s[:, [*kept, *(count + i for i in kept)]] for s in strata]


def _cells(document: RunDocument, policy: str, axis: str) -> list[PlannedCell]:
    return [cell for cell in document.plan if cell.policy == policy and cell.axis in (axis, CLEAN)]


def _perturbed(document: RunDocument, eligible: EligibleEpisodes, policies: Sequence[str]) -> list[Outcomes]:
    """Outcomes of all perturbed levels by task, shape (seeds, policies x levels)."""
    plan = [cell for cell in document.plan if cell.condition.is_on_scale and cell.severity]
    cells = [cell for policy in policies for cell in plan if cell.policy == policy]
    return list(eligible.by_condition(cells, tuple(dict.fromkeys(cell.condition for cell in plan))).values())


def _loss_rows(policy: str, axis: str, levels: Sequence[int], strata: Sequence[NDArray[np.floating]]) -> list[LossRow]:
    rows = []
    for place, severity in enumerate(levels):
        pairs = pooled(Pairs.from_outcomes(outcomes[:, place], outcomes[:, len(levels) + place]) for outcomes in strata)
        if pairs.trials:
            baseline, rate = pairs.first / pairs.trials, pairs.second / pairs.trials
            p = mcnemar(pairs)
            loss, evidence = paired_difference(pairs), paired_evidence(pairs)
            rows.append(LossRow(policy, axis, severity, pairs.trials, baseline, rate, loss, p, evidence, p))
    return rows


def interaction(policy: str, axis: str, strata: Sequence[Outcomes], axes: int) -> Interaction | None:
    """Estimate the loss against the baseline under an axis beyond the clean loss, with Student's intervals.

    Args:
        policy: The other policy.
        axis: The axis.
        strata: Per task, shape (seeds, 2 x levels), the baseline first, clean the first level of each; see
            `EligibleEpisodes.paired`.
        axes: Number of axes of the simultaneous interval.

    Returns:
        None without a seed that both played clean and at a level.
    """
    losses = [first - second for first, second in (np.hsplit(outcomes, 2) for outcomes in strata)]
    beyond = [loss[:, 1:] - loss[:, :1] for loss in losses]
    own, all_axes = (mean_of_levels(beyond, 1 - alpha) for alpha in (ALPHA, ALPHA / axes))
    return None if own is None or all_axes is None else Interaction(policy, axis, len(strata), own, all_axes.interval)


def equivalence(policy: str, strata: Sequence[Outcomes], margin: float) -> Equivalence | None:
    """Test whether a policy and the baseline differ by less than a margin over all perturbed levels together.

    D. J. Schuirmann, "A comparison of the two one-sided tests procedure and the power approach for assessing the
    equivalence of average bioavailability", J. Pharmacokinet. Biopharm. 15 (1987) 657-680: both tests at `ALPHA` reject
    where an interval of 1 - 2 `ALPHA` lies within the margins.

    Args:
        policy: The other policy.
        strata: Per task, shape (seeds, 2 x levels), the baseline first, NaN without a verdict.
        margin: The largest difference of rates that counts as none.

    Returns:
        None without a level that both have.
    """
    losses = [first - second for first, second in (np.hsplit(outcomes, 2) for outcomes in strata)]
    loss = mean_of_levels(losses, 1 - 2 * ALPHA)
    if loss is None:
        return None
    pairs = np.concatenate([~np.isnan(one) for one in losses])
    return Equivalence(policy, int(pairs.any(axis=0).sum()), int(pairs.sum()), loss, margin)


def _routers(document: RunDocument, eligible: EligibleEpisodes, policy: str, axis: str) -> list[RouterRow]:
    cells = _cells(document, policy, axis)
    rows: list[RouterRow] = []
    for severity in sorted({cell.severity for cell in cells}) if any(cell.axis == axis for cell in cells) else ():
        found = eligible.verdicts([cell for cell in cells if cell.severity == severity])
        routed = found[found["inferred_task"].notna()]
        if len(routed):
            right = routed["inferred_task"].astype(str) == routed["task"].astype(str)
            won = routed["status"].astype(str) == Status.SUCCESS
            counts = ((right, len(routed)), (won, len(routed)), (won & ~right, int((~right).sum())))
            rates = (Rate.from_counts(int(hits.sum()), trials) for hits, trials in counts)
            rows.append(RouterRow(policy, axis, severity, *rates))
    return rows
