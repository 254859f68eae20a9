"""`cells.csv`: the numbers of every policy, task and condition, for a spreadsheet."""

from __future__ import annotations

import csv
import io

from results.tables import CellRow, Tables
from suites.axes import AXES

HEADER = (
    *("simulator", "task", "policy", "policy_digest", "axis", "severity", "level", "unit"),
    *("planned", "done", "successes", "failures", "errors", "missing", "rate", "low", "high"),
    *("success_once", "mean_steps", "mean_seconds"),
)


def render_csv(tables: Tables) -> str:
    """A line per cell; rates and their Wilson intervals (95 %) are shares, what there is not is empty."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(HEADER)
    writer.writerows(_line(cell) for cell in tables.cells)
    return file.getvalue()


def _line(cell: CellRow) -> tuple[object, ...]:
    tally, axis = cell.tally, AXES.get(cell.axis)
    level = axis.value(cell.severity) if axis is not None and 0 < cell.severity <= len(axis.levels) else None
    interval = (tally.interval.low, tally.interval.high) if tally.interval else (None, None)
    return (
        *(cell.simulator, cell.task, cell.policy, cell.policy_digest, cell.axis, cell.severity),
        *(level, axis.unit if axis else None),
        *(tally.planned, tally.done, tally.successes, tally.failures, tally.errors, tally.missing),
        *(tally.rate, *interval, tally.success_once, tally.mean_steps, tally.mean_seconds),
    )
