"""Selection of the episodes of a perturbed run that count, and their outcomes as arrays for comparisons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robogauntlet.results.record import Status
from robogauntlet.results.run_document import PlannedCell, RunDocument
from robogauntlet.results.statistics.aggregate import Outcomes
from robogauntlet.suites.episode import CLEAN, CONTROLS, Condition

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

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


CELL = ["task", "policy_digest", "axis", "severity"]
"""Columns that identify a cell of the plan."""


@dataclass(frozen=True, eq=False)
class Rows:
    """The successes and failures of a run, indexed by cell."""

    frame: pd.DataFrame
    places: Mapping[tuple[str, str, str, int], NDArray[np.intp]]

    @classmethod
    def of_frame(cls, frame: pd.DataFrame) -> Rows:
        """Index the rows of a run; errors are dropped."""
        verdicts = frame[frame["status"] != str(Status.ERROR)]
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
        """Return success per task, shape (seeds, levels). Tasks without a verdict are left out.

        Args:
            cells: Cells of one policy under one axis and the clean condition.
            levels: Severities.
        """
        tables = [self._table(cells, task) for task in dict.fromkeys(cell.task for cell in cells)]
        return [table.reindex(columns=list(levels)).to_numpy(dtype=float) for table in tables if table is not None]

    def by_condition(self, cells: Sequence[PlannedCell], conditions: Sequence[Condition]) -> dict[str, Outcomes]:
        """Return success by task, shape (seeds, conditions). Tasks without a verdict are left out.

        Args:
            cells: Cells of one policy.
            conditions: Conditions of any axes; seeds are rejected per axis.
        """
        by_task = {}
        for task in dict.fromkeys(cell.task for cell in cells):
            own = [cell for cell in cells if cell.task == task and not self._is_capped(cell)]
            columns = {Condition(cell.axis, cell.severity): self._successes(cell) for cell in own}
            seeds = np.unique(np.concatenate([seeds for seeds, _ in columns.values()] or [np.empty(0, np.int64)]))
            if len(seeds):
                by_task[task] = outcomes = np.full((len(seeds), len(conditions)), np.nan)
                for place, condition in enumerate(conditions):
                    if condition in columns:
                        outcomes[np.searchsorted(seeds, columns[condition][0]), place] = columns[condition][1]
        return by_task

    def _successes(self, cell: PlannedCell) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Seeds of a cell that count, and their success."""
        rows, rejected = self.rows.of_cell(cell), self.rejected.get((cell.task, cell.axis), ())
        seeds = rows["seed"].to_numpy(dtype=np.int64)
        won = (rows["status"] == str(Status.SUCCESS)).to_numpy(dtype=float)
        eligible = ~np.isin(seeds, list(rejected))
        return seeds[eligible], won[eligible]

    def paired(self, sides: Sequence[Sequence[PlannedCell]], levels: Sequence[int]) -> list[Outcomes]:
        """Return outcomes of several policies on their common seeds.

        Args:
            sides: Per policy, its cells under one axis and the clean condition.
            levels: Severities.

        Returns:
            Per task that every policy has, shape (seeds, policies x levels).
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
        """Return the rows of these cells that count."""
        import pandas as pd

        parts = []
        for cell in cells:
            if not self._is_capped(cell):
                rows = self.rows.of_cell(cell)
                parts.append(rows[~rows["seed"].isin(self.rejected.get((cell.task, cell.axis), ()))])
        return pd.concat(parts) if parts else self.rows.frame[:0]

    def _table(self, cells: Sequence[PlannedCell], task: str) -> pd.DataFrame | None:
        """Success by seed and severity in one task; None without a verdict."""
        import pandas as pd

        of_task = [cell for cell in cells if cell.task == task]
        verdicts = [self.rows.of_cell(cell) for cell in of_task if not self._is_capped(cell)]
        if not verdicts:
            return None
        rows = pd.concat(verdicts)
        rejected = set().union(*(self.rejected.get((task, axis), ()) for axis in {cell.axis for cell in of_task}))
        rows = rows[~rows["seed"].isin(rejected)]
        if not len(rows):
            return None
        won = (rows["status"] == str(Status.SUCCESS)).astype(float)
        return won.groupby([rows["seed"], rows["severity"]]).first().unstack()

    def _is_capped(self, cell: PlannedCell) -> bool:
        return (cell.task, cell.axis, cell.severity) in self.capped


def select_eligible(document: RunDocument, frame: pd.DataFrame) -> EligibleEpisodes:
    """Select the episodes of a run that count.

    Args:
        document: The run.
        frame: Rows with task, policy_digest, axis, severity, seed and status.
    """
    rows = Rows.of_frame(frame)
    gate_rows = _gate_rows(document, rows)
    capped = {(row.task, row.axis, row.severity) for row in gate_rows if row.capped}
    return EligibleEpisodes(rows, gate_rows, _rejected(document, rows, capped), capped)


def _gate_rows(document: RunDocument, rows: Rows) -> tuple[GateRow, ...]:
    """Seeds that the oracle gate solved, per condition. Controls are left out: they are not meant to be solved."""
    gate_rows = []
    for cell in document.plan:
        if cell.policy == document.suite.oracle_gate and cell.axis not in CONTROLS:
            won = rows.of_cell(cell)["status"] == str(Status.SUCCESS)
            seeds, passed = len(won), int(won.sum())
            capped = cell.axis != CLEAN and seeds > 0 and passed < LEAST_SOLVED * seeds
            gate_rows.append(GateRow(cell.task, cell.axis, cell.severity, seeds, passed, capped))
    return tuple(gate_rows)


def _rejected(document: RunDocument, rows: Rows, capped: Set[tuple[str, str, int]]) -> Rejected:
    """Seeds that the gate did not solve under the clean condition or at a level that counts.

    They are left out at every level and for all policies, so that each level is compared with clean episodes of the
    same seeds.
    """
    rejected: dict[tuple[str, str], set[int]] = {}
    for cell in document.plan:
        if (
            cell.policy != document.suite.oracle_gate
            or cell.axis in CONTROLS
            or (cell.task, cell.axis, cell.severity) in capped
        ):
            continue
        verdicts = rows.of_cell(cell)
        unsolved = verdicts[verdicts["status"] != str(Status.SUCCESS)]["seed"]
        rejected.setdefault((cell.task, cell.axis), set()).update(unsolved.tolist())
    return rejected
