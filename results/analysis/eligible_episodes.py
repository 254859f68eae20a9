"""Selection of the episodes of a perturbed run that count, and their outcomes as arrays for comparisons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.record import Status
from robogauntlet.results.run_document import PlannedCell, RunDocument
from robogauntlet.results.statistics.aggregate import Outcomes
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CLEAN, CONTROLS, Condition

if TYPE_CHECKING:
    import pandas as pd

Column = TypeVar("Column", int, tuple[str, Condition])
Seeds = NDArray[np.int64]
LEAST_SOLVED = 0.95
"""Share of seeds that the oracle gate must solve at a level. Below it, the level is left out for the task."""


@dataclass(frozen=True, slots=True)
class GateRow:
    """Result of the oracle gate on one task under one condition."""

    task: str
    axis: str
    severity: int
    seeds: int
    """Seeds that the gate played without an error."""
    passed: int
    capped: bool
    """Whether too few passed, so that the level is left out for this task."""


def is_undelivered(frame: pd.DataFrame) -> pd.Series[bool]:
    """Whether what the axis delivered in an episode was measured, and is the value of the clean episode."""
    if "delivered" not in frame:
        return frame["status"].isna()
    unchanged = frame["axis"].astype(str).map({name: axis.unchanged for name, axis in AXES.items()})
    return frame["delivered"] == unchanged.astype(float)


CELL = ["task", "policy_digest", "axis", "severity"]
"""Columns that identify a cell of the plan."""


@dataclass(frozen=True, eq=False)
class Rows:
    """The successes and failures of a run, indexed by cell."""

    frame: pd.DataFrame
    places: Mapping[tuple[str, str, str, int], NDArray[np.intp]]

    @classmethod
    def of_frame(cls, frame: pd.DataFrame) -> Rows:
        """Index the rows of a run; errors, and episodes in which the axis changed nothing, are dropped."""
        verdicts = frame[(frame["status"] != str(Status.ERROR)) & ~is_undelivered(frame)]
        groups = verdicts.groupby(CELL, observed=True, sort=False).indices if len(verdicts) else {}
        return cls(verdicts, {(str(t), str(p), str(a), int(s)): rows for (t, p, a, s), rows in groups.items()})

    def of_cell(self, cell: PlannedCell) -> pd.DataFrame:
        """Return the rows of one cell."""
        indices = self.places.get((cell.task, cell.policy_digest, cell.axis, cell.severity))
        return self.frame[:0] if indices is None else self.frame.iloc[indices]


Rejected = Mapping[tuple[str, str], Set[int]]
"""(task, axis) to rejected seeds."""


@dataclass(frozen=True, eq=False)
class EligibleEpisodes:
    """Rows of a run, without seeds and levels that the oracle gate rejects."""

    rows: Rows
    gate_rows: tuple[GateRow, ...]
    """Per condition of each task."""
    rejected: Rejected
    capped: Set[tuple[str, str, int]]

    def outcomes(self, cells: Sequence[PlannedCell], levels: Sequence[int]) -> list[Outcomes]:
        """Return success per task, shape (seeds, levels), of one policy under one axis and the clean condition.

        Tasks without a verdict are left out.
        """
        tables = (self._table(cells, task, levels) for task in dict.fromkeys(cell.task for cell in cells))
        return [outcomes for seeds, outcomes in tables if len(seeds)]

    def by_condition(self, cells: Sequence[PlannedCell], conditions: Sequence[Condition]) -> dict[str, Outcomes]:
        """Return success by task; seeds are rejected per axis.

        Returns:
            Per task, shape (seeds, policies x conditions), policies in the order of `cells`. Tasks without a verdict
            are left out.
        """
        order = [(policy, one) for policy in dict.fromkeys(cell.policy for cell in cells) for one in conditions]
        by_task = {}
        for task in dict.fromkeys(cell.task for cell in cells):
            columns = {
                (cell.policy, cell.condition): self._successes(cell, self.rejected.get((task, cell.axis), set()))
                for cell in cells
                if cell.task == task and not self._is_capped(cell)
            }
            seeds, outcomes = _side_by_side(columns, order)
            if len(seeds):
                by_task[task] = outcomes
        return by_task

    def paired(self, sides: Sequence[Sequence[PlannedCell]], levels: Sequence[int]) -> list[Outcomes]:
        """Return outcomes of several policies on their common seeds, under one axis and the clean condition.

        Returns:
            Per task that every policy has, shape (seeds, policies x levels).
        """
        found = []
        for task in dict.fromkeys(cell.task for cell in sides[0]):
            tables = [self._table(cells, task, levels) for cells in sides]
            common = reduce(np.intersect1d, (seeds for seeds, _ in tables))
            if len(common):
                found.append(np.hstack([outcomes[np.searchsorted(seeds, common)] for seeds, outcomes in tables]))
        return found

    def verdicts(self, cells: Sequence[PlannedCell]) -> pd.DataFrame:
        """Return the rows of these cells that count."""
        import pandas as pd

        parts = []
        for cell in cells:
            if not self._is_capped(cell):
                rows = self.rows.of_cell(cell)
                parts.append(rows[~rows["seed"].isin(self.rejected.get((cell.task, cell.axis), ()))])
        return pd.concat(parts) if parts else self.rows.frame[:0]

    def _table(self, cells: Sequence[PlannedCell], task: str, levels: Sequence[int]) -> tuple[Seeds, Outcomes]:
        """Seeds of a task, and success by seed and level. Seeds that any of the axes rejects are left out."""
        of_task = [cell for cell in cells if cell.task == task]
        rejected = set().union(*(self.rejected.get((task, cell.axis), ()) for cell in of_task))
        kept = [cell for cell in of_task if not self._is_capped(cell)]
        return _side_by_side({cell.severity: self._successes(cell, rejected) for cell in kept}, levels)

    def _successes(self, cell: PlannedCell, rejected: Set[int]) -> tuple[Seeds, NDArray[np.float64]]:
        """Seeds of a cell that are not rejected, and their success."""
        rows = self.rows.of_cell(cell)
        seeds = rows["seed"].to_numpy(dtype=np.int64)
        won = (rows["status"] == str(Status.SUCCESS)).to_numpy(dtype=float)
        eligible = ~np.isin(seeds, list(rejected))
        return seeds[eligible], won[eligible]

    def _is_capped(self, cell: PlannedCell) -> bool:
        return (cell.task, cell.axis, cell.severity) in self.capped


def _side_by_side(
    columns: Mapping[Column, tuple[Seeds, NDArray[np.float64]]], order: Sequence[Column]
) -> tuple[Seeds, Outcomes]:
    """Seeds of all columns, and outcomes of shape (seeds, len(order)), NaN without a verdict."""
    seeds = np.unique(np.concatenate([own for own, _ in columns.values()] or [np.empty(0, np.int64)]))
    outcomes = np.full((len(seeds), len(order)), np.nan)
    for place, column in enumerate(order):
        if column in columns:
            own, won = columns[column]
            outcomes[np.searchsorted(seeds, own), place] = won
    return seeds, outcomes


def select_eligible(document: RunDocument, frame: pd.DataFrame) -> EligibleEpisodes:
    """Select the episodes of a run that count, from rows with task, policy_digest, axis, severity, seed and status.

    Controls are not gated: they are not meant to be solved. A seed that the gate did not solve under the clean
    condition or at a level that counts is rejected at every level and for all policies, so that each level is compared
    with clean episodes of the same seeds.
    """
    rows, gate_rows = Rows.of_frame(frame), []
    rejected: dict[tuple[str, str], set[int]] = {}
    for cell in document.plan:
        if cell.policy != document.suite.oracle_gate or cell.axis in CONTROLS:
            continue
        verdicts = rows.of_cell(cell)
        won = verdicts["status"] == str(Status.SUCCESS)
        seeds, passed = len(won), int(won.sum())
        capped = cell.axis != CLEAN and seeds > 0 and passed < LEAST_SOLVED * seeds
        gate_rows.append(GateRow(cell.task, cell.axis, cell.severity, seeds, passed, capped))
        if not capped:
            rejected.setdefault((cell.task, cell.axis), set()).update(verdicts["seed"][~won].tolist())
    levels_left_out = {(row.task, row.axis, row.severity) for row in gate_rows if row.capped}
    return EligibleEpisodes(rows, tuple(gate_rows), rejected, levels_left_out)
