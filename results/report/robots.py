"""The table of tasks that several robots play, for `report.md` and `report.html`."""

from __future__ import annotations

from collections.abc import Sequence

from robogauntlet.results.analysis.robots import RobotRow
from robogauntlet.results.report.formatting import TextTable, points, share

HEADER = ("task", "policy", "robot", "success", "to the first robot (points)")
EXPLANATION = (
    "Clean episodes of tasks that several robots play. Differences are of success rates, in percentage points, with "
    "Newcombe's interval (95 %) for separate trials: seeds are not paired, since objects may lie elsewhere for another "
    "robot."
)


def robot_table(rows: Sequence[RobotRow]) -> TextTable:
    """Success of each policy and robot, and its difference to the first robot's."""
    lines = ((row.task, row.policy, row.robot, share(row.tally), points(row.difference)) for row in rows)
    return TextTable(HEADER, tuple(lines), 3)
