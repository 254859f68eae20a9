"""How policies differ when the world changes: what one loses against another, and whether its router broke first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from results.judging import Judged
from results.routing import Rate
from results.run import Decided, PlannedCell, RunDocument
from results.statistics.aggregate import DRAWS, mean_outcomes, resampled_means
from results.statistics.multiplicity import ALPHA, benjamini_hochberg
from results.statistics.pairs import Pairs, mcnemar, paired_difference, pooled
from results.statistics.rates import CONFIDENCE, Estimate, Interval
from results.statistics.sequential import paired_evidence
from suites.schema import AdaptiveEntry
from suites.vocabulary import CLEAN, CONTROLS, content_hash

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class TaxRow:
    """Baseline minus other policy at one level, on the seeds at which both have a verdict."""

    policy: str
    """The other."""
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
    """E-value, which may be looked at as often as one likes; 20 decides at 5 %."""
    adjusted: float
    """Benjamini-Hochberg over all levels and axes of this policy."""


@dataclass(frozen=True, slots=True)
class Interaction:
    """Whether a policy loses more against the baseline under an axis than in the clean world."""

    policy: str
    axis: str
    tasks: int
    extra: Estimate
    """Mean loss over the severities minus the clean loss; tasks weigh alike."""
    corrected: Interval | None
    """The interval at a confidence that makes all axes of this policy hold together (Bonferroni)."""

    @property
    def is_shown(self) -> bool:
        """Whether the sign of it is more than chance, the number of axes taken into account."""
        ends = self.corrected
        return ends is not None and (ends.low > 0 or ends.high < 0)


@dataclass(frozen=True, slots=True)
class RouterRow:
    """Whether a policy still knew its task at one level, over all simulators."""

    policy: str
    axis: str
    severity: int
    right: Rate
    """Episodes in which the task was inferred rightly."""
    success: Rate
    misrouted: Rate
    """Success of the episodes in which it was not."""


@dataclass(frozen=True, slots=True)
class Shift:
    """The comparison of policies under perturbations."""

    baseline: str
    others: tuple[str, ...]
    taxes: tuple[TaxRow, ...]
    interactions: tuple[Interaction, ...]
    routers: tuple[RouterRow, ...]
    rule: AdaptiveEntry | None = None
    """By which conditions stopped early, if by any."""
    decided: tuple[Decided, ...] = ()


def build_shift(document: RunDocument, judged: Judged) -> Shift | None:
    """The comparison that the suite asks for, or None if it asks for none.

    Args:
        document: The run.
        judged: What counts of its rows, `inferred_task` among their columns.
    """
    sides = document.compare
    if sides is None:
        return None
    axes = tuple(dict.fromkeys(c.axis for c in document.plan if c.axis not in (CLEAN, *CONTROLS)))
    taxes, interactions = [], []
    for policy in sides.others:
        rows: list[TaxRow] = []
        for axis in axes:
            cells = [_cells(document, name, axis) for name in (sides.baseline, policy)]
            levels = sorted({cell.severity for cell in cells[0]} & {cell.severity for cell in cells[1]})
            levels, strata = _judged_levels(levels, judged.paired(cells, levels))
            if len(levels) < 2 or levels[0] != 0 or not strata:
                continue
            rows += [row for row in _taxes(policy, axis, levels, strata) if row.severity or not rows]
            interactions.append(interaction(policy, axis, len(levels), strata, len(axes)))
        taxes += _adjusted(rows)
    routers = [row for policy in sides.others for axis in axes for row in _routers(document, judged, policy, axis)]
    return Shift(
        sides.baseline,
        sides.others,
        tuple(taxes),
        tuple(interactions),
        tuple(routers),
        document.adaptive,
        document.decided,
    )


def _judged_levels(
    levels: Sequence[int], strata: Sequence[NDArray[np.floating]]
) -> tuple[list[int], list[NDArray[np.floating]]]:
    """Without levels at which no pair has a verdict on both sides, as where a gate left them out in every task."""
    count = len(levels)
    kept = [i for i in range(count) if any((~np.isnan(s[:, i]) & ~np.isnan(s[:, count + i])).any() for s in strata)]
    return [levels[i] for i in kept], [s[:, [*kept, *(count + i for i in kept)]] for s in strata]


def _cells(document: RunDocument, policy: str, axis: str) -> list[PlannedCell]:
    return [cell for cell in document.plan if cell.policy == policy and cell.axis in (axis, CLEAN)]


def _taxes(policy: str, axis: str, levels: Sequence[int], strata: Sequence[NDArray[np.floating]]) -> list[TaxRow]:
    rows = []
    for place, severity in enumerate(levels):
        pairs = pooled(Pairs.of(outcomes[:, place], outcomes[:, len(levels) + place]) for outcomes in strata)
        if pairs.trials:
            one, other = pairs.first / pairs.trials, pairs.second / pairs.trials
            p = mcnemar(pairs)
            rows.append(
                TaxRow(
                    policy,
                    axis,
                    severity,
                    pairs.trials,
                    one,
                    other,
                    paired_difference(pairs),
                    p,
                    paired_evidence(pairs),
                    p,
                )
            )
    return rows


def _adjusted(rows: Sequence[TaxRow]) -> list[TaxRow]:
    values = benjamini_hochberg([row.p for row in rows]) if rows else ()
    return [replace(row, adjusted=value) for row, value in zip(rows, values, strict=True)]


def interaction(
    policy: str, axis: str, levels: int, strata: Sequence[NDArray[np.floating]], axes: int, draws: int = DRAWS
) -> Interaction:
    """What a policy loses against the baseline under an axis beyond what it loses clean.

    Args:
        policy: The other policy.
        axis: The axis.
        levels: Of each side, the clean one first.
        strata: Of each task, shape (seeds, 2 x levels), the baseline's first; see `Judged.paired`.
        axes: That are to hold together.
        draws: Data sets drawn.
    """
    generator = np.random.default_rng(int(content_hash(["interaction", policy, axis]), 16))
    value = float(_extra(mean_outcomes(strata)[None], levels)[0])
    drawn = _extra(resampled_means(strata, generator, draws), levels)
    own, corrected = (_ends(drawn, confidence) for confidence in (CONFIDENCE, 1 - ALPHA / axes))
    return Interaction(policy, axis, len(strata), Estimate(value, own), corrected)


def _extra(means: NDArray[np.float64], levels: int) -> NDArray[np.float64]:
    """Mean loss over the perturbed levels minus the clean one, shape (draws,).

    Args:
        means: Mean outcomes, shape (draws, strata, 2 x levels), the baseline's first.
        levels: Of each side.
    """
    loss = means[..., :levels] - means[..., levels:]
    with np.errstate(invalid="ignore"):
        by_level = np.nanmean(loss[..., 1:] - loss[..., :1], axis=-2)
    return np.asarray(by_level.mean(axis=-1), dtype=np.float64)


def _ends(drawn: NDArray[np.float64], confidence: float) -> Interval | None:
    """Percentiles of a bootstrap; None where it has no value or shows no spread."""
    if np.isnan(drawn).any() or drawn.max() == drawn.min():
        return None
    low, high = np.quantile(drawn, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Interval(float(low), float(high))


def _routers(document: RunDocument, judged: Judged, policy: str, axis: str) -> list[RouterRow]:
    cells = _cells(document, policy, axis)
    if not any(cell.axis == axis for cell in cells):
        return []
    rows = []
    for severity in sorted({cell.severity for cell in cells}):
        found = judged.verdicts([cell for cell in cells if cell.severity == severity])
        routed = found[found["inferred_task"].notna()]
        if len(routed):
            rows.append(_router(policy, axis, severity, routed))
    return rows


def _router(policy: str, axis: str, severity: int, routed: pd.DataFrame) -> RouterRow:
    right = routed["inferred_task"].astype(str) == routed["task"].astype(str)
    won = routed["status"].astype(str) == "success"
    return RouterRow(
        policy,
        axis,
        severity,
        Rate.of(int(right.sum()), len(right)),
        Rate.of(int(won.sum()), len(won)),
        Rate.of(int((won & ~right).sum()), int((~right).sum())),
    )


def broke_first(rows: Sequence[RouterRow]) -> str | None:
    """What gave way at the first level at which success is below the clean rate beyond chance, in a few words.

    Args:
        rows: Of one policy along one axis, from the clean condition on.

    Returns:
        `router` if more than half of what was lost there was lost on misrouted episodes, else `policy`; None where
        nothing was shown to be lost.
    """
    if len(rows) < 2 or rows[0].severity:
        return None
    clean = rows[0].success
    floor, usual = clean.interval, clean.rate
    for row in rows[1:]:
        ends = row.success.interval
        if floor is None or usual is None or ends is None or ends.high >= floor.low:
            continue
        lost = usual * row.success.trials - row.success.successes
        on_misrouted = usual * row.misrouted.trials - row.misrouted.successes
        return "router" if on_misrouted > lost / 2 else "policy"
    return None
