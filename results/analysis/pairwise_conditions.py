"""Paired differences of two policies under perturbations, a line per condition.

Episodes are paired by `pair_id` (task, condition, seed and protocol), and the pairs of all tasks are added up.
Severities are not added up: they start from the same seeds, so that their pairs are not independent. The p-values of an
axis are adjusted together by Holm's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from robogauntlet.results.record import Status
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.statistics.multiplicity import holm
from robogauntlet.results.statistics.pairs import Pairs, can_reject, detectable_drop, mcnemar, paired_difference
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.suites.episode import AT, CONTROLS, Condition

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class ConditionLine:
    """A perturbation axis at one severity."""

    axis: str
    severity: int
    tasks: int
    """Tasks that have pairs."""
    pairs: Pairs
    difference: Estimate
    """Success rate of the first policy minus that of the second, between -1 and 1, with a confidence of 1 - alpha."""
    p: float
    """McNemar's exact test, two-sided."""
    detectable: float | None
    """The smallest difference that this many pairs show with a probability of 0.8, see `pairs.detectable_drop`."""
    adjusted: float = 1.0
    """The p-value adjusted by Holm's method among the severities of the axis."""

    @property
    def condition(self) -> Condition:
        """The axis and severity."""
        return Condition(self.axis, self.severity)


def perturbed_rows(rows: pd.DataFrame) -> pd.DataFrame:
    """The episodes under perturbations; controls, whose success is not what is wanted, are none."""
    combined = rows["axis"].astype(str).str.contains(AT, regex=False)
    return rows[(rows["severity"] > 0) & ~rows["axis"].isin(CONTROLS) & ~combined]


def condition_lines(shared: pd.DataFrame, document: RunDocument, alpha: float) -> tuple[ConditionLine, ...]:
    """A line per condition, in the order of the plan.

    Args:
        shared: A row per pair with the columns `axis`, `severity`, `task`, `status` and `status_before`, the outcome of
            the second policy; both are verdicts.
        document: The run of the first policy.
        alpha: 1 - alpha is the confidence of the intervals.
    """
    planned = list(dict.fromkeys(cell.axis for cell in document.plan))
    lines = []
    for key, own in shared.groupby(["axis", "severity"], sort=True, observed=True):
        won = (own[column] == str(Status.SUCCESS) for column in ("status", "status_before"))
        pairs = Pairs.from_outcomes(*(side.to_numpy(float) for side in won))
        difference, (axis, severity) = paired_difference(pairs, 1 - alpha), key
        assert difference is not None  # There is a pair.
        tested = (mcnemar(pairs), detectable_drop(pairs, alpha / 2))
        lines.append(ConditionLine(str(axis), int(severity), own["task"].nunique(), pairs, difference, *tested))
    return tuple(sorted(lines, key=lambda line: planned.index(line.axis)))


def adjusted_by_axis(compared: Sequence[Sequence[ConditionLine]], alpha: float) -> list[tuple[ConditionLine, ...]]:
    """Add the adjusted p-values: an axis, in all comparisons, is a family.

    Lines whose test cannot reach alpha are not in the family and have 1, see `pairs.can_reject`.
    """
    found: dict[int, float] = {}
    for axis in {line.axis for lines in compared for line in lines}:
        own = [line for lines in compared for line in lines if line.axis == axis and can_reject(line.pairs, alpha / 2)]
        found |= zip(map(id, own), holm([line.p for line in own]), strict=True)
    return [tuple(replace(line, adjusted=found.get(id(line), 1.0)) for line in lines) for lines in compared]
