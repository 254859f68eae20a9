"""How two sides move and fail on the same episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.contrasts import together
from robogauntlet.results.analysis.failures import OTHER, OUTCOMES
from robogauntlet.results.record import BEHAVIOUR, Status, known_kind
from robogauntlet.results.statistics.paired_numbers import can_reject_symmetry, median_difference, signed_rank
from robogauntlet.results.statistics.rates import Estimate

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("task", "seed", "status", *BEHAVIOUR)
"""Fields of the record that are needed of each side."""
MEASURES = ("path_length", "time_to_success", "smoothness", "gripper_openings", "contact_steps", "contact_force")
"""Fields of the record that are compared."""
LEAST_PAIRS = 6
"""Pairs from which a measure is compared: of fewer, the signed-rank test never reaches 0.05."""
DIGITS = 6
"""To which differences are rounded, so that equal ones have equal ranks."""


@dataclass(frozen=True, slots=True)
class MeasureLine:
    """A measure in the pairs in which both succeeded."""

    measure: str
    """Field of the record, one of `MEASURES`."""
    pairs: int
    """Start states (task and seed); several pairs of one count as their mean."""
    difference: Estimate
    """Median of first minus second, in the unit of the field."""
    p: float
    """Wilcoxon's signed-rank test, two-sided."""
    is_tested: bool
    """Whether enough pairs differ for the test to reach alpha."""
    adjusted: float = 1.0
    """The p-value adjusted by Holm's method over all tested measures."""


@dataclass(frozen=True, slots=True)
class OutcomeChange:
    """Pairs with these two outcomes."""

    first: str
    """Success, or the kind of the failure: one of `failures.OUTCOMES`."""
    second: str
    pairs: int


@dataclass(frozen=True, slots=True)
class BehaviourComparison:
    """How two sides move and fail on the same episodes."""

    pairs: int
    """Pairs in which both succeeded."""
    measures: tuple[MeasureLine, ...]
    """Empty with fewer than `LEAST_PAIRS`."""
    changes: tuple[OutcomeChange, ...]
    """Outcomes of all pairs in which a side failed."""


def compare_behaviour(shared: pd.DataFrame, alpha: float) -> BehaviourComparison | None:
    """Compare two sides.

    Args:
        shared: A row per pair with the columns `COLUMNS`; those of the second side end in `_before`.
        alpha: 1 - alpha is the confidence of intervals.

    Returns:
        The comparison, not yet adjusted; None if the behaviour of a side was not measured.
    """
    if any(shared[[f"{name}{side}" for name in BEHAVIOUR]].isna().to_numpy().all() for side in ("", "_before")):
        return None
    won = shared[(shared["status"] == str(Status.SUCCESS)) & (shared["status_before"] == str(Status.SUCCESS))]
    lines = [_line(won, name, alpha) for name in MEASURES]
    return BehaviourComparison(len(won), tuple(line for line in lines if line is not None), outcome_changes(shared))


def _line(won: pd.DataFrame, name: str, alpha: float) -> MeasureLine | None:
    """None with too few pairs."""
    values = (won[name].astype(float) - won[f"{name}_before"].astype(float)).rename("difference")
    known = won[["task", "seed"]].astype({"task": str}).assign(difference=values).dropna()
    trials = known.groupby(["task", "seed"])["difference"].mean().round(DIGITS).to_numpy(float)
    if len(trials) < LEAST_PAIRS:
        return None
    estimate, is_tested = median_difference(trials, 1 - alpha), can_reject_symmetry(trials, alpha)
    return MeasureLine(name, len(trials), estimate, signed_rank(trials), is_tested)


def outcome_changes(shared: pd.DataFrame) -> tuple[OutcomeChange, ...]:
    """Count the pairs in which a side failed by their outcomes; empty if no failure has a known kind."""
    sides = []
    for side in ("", "_before"):
        rows = zip(shared[f"status{side}"], shared[f"failure{side}"], strict=True)
        sides.append(
            [str(status) if status != Status.FAILURE else str(known_kind(kind) or OTHER) for status, kind in rows]
        )
    counts: dict[tuple[str, str], int] = {}
    for both in zip(*sides, strict=True):
        counts[both] = counts.get(both, 0) + 1
    named = {outcome for both in counts for outcome in both}
    if not named - {OUTCOMES[0], OTHER}:
        return ()
    order = sorted(counts, key=lambda both: tuple(map(OUTCOMES.index, both)))
    return tuple(OutcomeChange(*both, counts[both]) for both in order if both != (OUTCOMES[0], OUTCOMES[0]))


def adjusted(compared: Sequence[BehaviourComparison | None]) -> list[BehaviourComparison | None]:
    """Add adjusted p-values: the tested measures of all comparisons are a family; the others have 1."""
    families = [() if one is None else one.measures for one in compared]
    p_values = together([[line.p if line.is_tested else None for line in lines] for lines in families])
    found = [
        tuple(replace(line, adjusted=p) for line, p in zip(*own, strict=True))
        for own in zip(families, p_values, strict=True)
    ]
    return [one and replace(one, measures=lines) for one, lines in zip(compared, found, strict=True)]
