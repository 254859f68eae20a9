"""Success in a task by the robot that plays it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from robogauntlet.results.analysis.tables import CellRow, Tables, Tally
from robogauntlet.results.statistics.rates import Estimate, rate_difference
from robogauntlet.suites.episode import AT, Condition


@dataclass(frozen=True, slots=True)
class RobotRow:
    """One policy in one task with one of the robots that play it."""

    policy: str
    task: str
    """Its name without the robot."""
    robot: str
    """Its name in the simulator."""
    tally: Tally
    difference: Estimate | None
    """To the first robot of the plan; not paired, since few simulators place objects alike for robots with different
    numbers of joints. None for the first robot, or without a success or failure on a side."""


def compare_robots(robots: Mapping[str, str], tables: Tables) -> tuple[RobotRow, ...]:
    """Rows of every task that several robots play, of clean episodes, by task and policy.

    `robots` has the robot of each task that several can play.
    """
    played: dict[tuple[str, str], list[CellRow]] = {}
    for cell in tables.cells:
        if cell.condition == Condition() and cell.task in robots:
            played.setdefault((cell.task.partition(AT)[0], cell.policy), []).append(cell)
    return tuple(
        RobotRow(
            policy,
            task,
            robots[cell.task],
            cell.tally,
            None if cell is cells[0] else rate_difference(_counts(cell.tally), _counts(cells[0].tally)),
        )
        for (task, policy), cells in played.items()
        if len({cell.task for cell in cells}) > 1
        for cell in cells
    )


def _counts(tally: Tally) -> tuple[int, int]:
    return tally.successes, tally.verdicts
