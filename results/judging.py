"""Which episodes of a perturbed run count, and their outcomes side by side: what every comparison is made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from results.record import Status
from results.run import PlannedCell, RunDocument
from results.statistics.aggregate import Outcomes
from suites.vocabulary import CLEAN, CONTROLS, Condition

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

LEAST_SOLVED = 0.95
"""Share of the seeds that the gate must solve at a level; below, the level says nothing about the task."""


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


CELL = ["task", "policy_digest", "axis", "severity"]
"""What makes a cell of the plan, among the columns."""


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows that are successes or failures, found by cell: a million of them are searched once."""

    frame: pd.DataFrame
    places: Mapping[tuple[str, str, str, int], NDArray[np.intp]]

    @classmethod
    def of_frame(cls, frame: pd.DataFrame) -> Rows:
        """Index the rows of a run."""
        verdicts = frame[frame["status"] != str(Status.ERROR)]
        groups = verdicts.groupby(CELL, observed=True, sort=False).indices if len(verdicts) else {}
        return cls(verdicts, {(str(t), str(p), str(a), int(s)): rows for (t, p, a, s), rows in groups.items()})

    def of(self, cell: PlannedCell) -> pd.DataFrame:
        """A cell's."""
        found = self.places.get((cell.task, cell.policy_digest, cell.axis, cell.severity))
        return self.frame[:0] if found is None else self.frame.iloc[found]


Rejected = Mapping[tuple[str, str], Set[int]]


@dataclass(frozen=True, eq=False)
class Judged:
    """Rows, and what of them does not count."""

    rows: Rows
    gated: tuple[GateRow, ...]
    """What the gate solved, condition by condition."""
    rejected: Rejected
    capped: Set[tuple[str, str, int]]

    def outcomes(self, cells: Sequence[PlannedCell], levels: Sequence[int]) -> list[Outcomes]:
        """Success of each task's seeds at each level, shape (seeds, levels), tasks without any verdict left out.

        Args:
            cells: Of one policy under one axis and the clean condition.
            levels: Severities.
        """
        tables = [self._table(cells, task) for task in dict.fromkeys(cell.task for cell in cells)]
        return [table.reindex(columns=list(levels)).to_numpy(dtype=float) for table in tables if table is not None]

    def by_condition(self, cells: Sequence[PlannedCell], conditions: Sequence[Condition]) -> dict[str, Outcomes]:
        """Success of each task's seeds under each condition, shape (seeds, conditions), tasks without verdict left out.

        Args:
            cells: Of one policy.
            conditions: Of any axes; each axis keeps its own seeds, see `rejected`.
        """
        found = {}
        for task in dict.fromkeys(cell.task for cell in cells):
            own = [cell for cell in cells if cell.task == task and not self._is_capped(cell)]
            columns = {Condition(cell.axis, cell.severity): self._won(cell) for cell in own}
            seeds = np.unique(np.concatenate([seeds for seeds, _ in columns.values()] or [np.empty(0, np.int64)]))
            if len(seeds):
                found[task] = outcomes = np.full((len(seeds), len(conditions)), np.nan)
                for place, condition in enumerate(conditions):
                    if condition in columns:
                        outcomes[np.searchsorted(seeds, columns[condition][0]), place] = columns[condition][1]
        return found

    def _won(self, cell: PlannedCell) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Seeds of a cell that count, and their success."""
        rows, out = self.rows.of(cell), self.rejected.get((cell.task, cell.axis), ())
        seeds = rows["seed"].to_numpy(dtype=np.int64)
        won = (rows["status"] == str(Status.SUCCESS)).to_numpy(dtype=float)
        counts = ~np.isin(seeds, list(out))
        return seeds[counts], won[counts]

    def paired(self, sides: Sequence[Sequence[PlannedCell]], levels: Sequence[int]) -> list[Outcomes]:
        """The same of several policies beside each other, on the seeds that each has rows for.

        Args:
            sides: Cells of one policy each, all under one axis and the clean condition.
            levels: Severities.

        Returns:
            Of each task that every side has, shape (seeds, sides x levels).
        """
        import pandas as pd

        found = []
        for task in dict.fromkeys(cell.task for cell in sides[0]):
            tables = [self._table(cells, task) for cells in sides]
            if not any(table is None for table in tables):
                wide = [table.reindex(columns=list(levels)) for table in tables if table is not None]
                found.append(pd.concat(wide, axis=1, join="inner").to_numpy(dtype=float))
        return [outcomes for outcomes in found if len(outcomes)]

    def verdicts(self, cells: Sequence[PlannedCell]) -> pd.DataFrame:
        """The rows of these cells that are successes or failures and count."""
        parts = []
        for cell in cells:
            if not self._is_capped(cell):
                rows = self.rows.of(cell)
                parts.append(rows[~rows["seed"].isin(self.rejected.get((cell.task, cell.axis), ()))])
        return _together(parts) if parts else self.rows.frame[:0]

    def _table(self, cells: Sequence[PlannedCell], task: str) -> pd.DataFrame | None:
        """Success, seeds x severities, of one task's cells; None without a verdict."""
        own = [cell for cell in cells if cell.task == task]
        verdicts = [self.rows.of(cell) for cell in own if not self._is_capped(cell)]
        if not verdicts:
            return None
        rows = _together(verdicts)
        out = set().union(*(self.rejected.get((task, axis), ()) for axis in {cell.axis for cell in own}))
        rows = rows[~rows["seed"].isin(out)]
        if not len(rows):
            return None
        won = (rows["status"] == str(Status.SUCCESS)).astype(float)
        return won.groupby([rows["seed"], rows["severity"]]).first().unstack()

    def _is_capped(self, cell: PlannedCell) -> bool:
        return (cell.task, cell.axis, cell.severity) in self.capped


def judge(document: RunDocument, frame: pd.DataFrame) -> Judged:
    """What counts of a run.

    Args:
        document: The run.
        frame: Its rows, with task, policy_digest, axis, severity, seed and status.
    """
    rows = Rows.of_frame(frame)
    gated = _gated(document, rows)
    capped = {(row.task, row.axis, row.severity) for row in gated if row.capped}
    return Judged(rows, gated, _rejected(document, rows, capped), capped)


def _gated(document: RunDocument, rows: Rows) -> tuple[GateRow, ...]:
    """What the gate solved, condition by condition; controls are not meant to be solved."""
    found = []
    for cell in document.plan:
        if cell.policy == document.gate and cell.axis not in CONTROLS:
            won = rows.of(cell)["status"] == str(Status.SUCCESS)
            seeds, passed = len(won), int(won.sum())
            capped = cell.axis != CLEAN and seeds > 0 and passed < LEAST_SOLVED * seeds
            found.append(GateRow(cell.task, cell.axis, cell.severity, seeds, passed, capped))
    return tuple(found)


def _rejected(document: RunDocument, rows: Rows, capped: Set[tuple[str, str, int]]) -> Rejected:
    """(task, axis) to the seeds that the gate did not solve under the clean condition or at a level that counts.

    They are left out at every level and for all policies alike: else a level would be compared with the clean
    episodes of other seeds.
    """
    rejected: dict[tuple[str, str], set[int]] = {}
    for cell in document.plan:
        if cell.policy != document.gate or cell.axis in CONTROLS or (cell.task, cell.axis, cell.severity) in capped:
            continue
        verdicts = rows.of(cell)
        unsolved = verdicts[verdicts["status"] != str(Status.SUCCESS)]["seed"]
        rejected.setdefault((cell.task, cell.axis), set()).update(unsolved.tolist())
    return rejected


def _together(frames: Sequence[pd.DataFrame]) -> pd.DataFrame:
    import pandas as pd

    return pd.concat(frames)
