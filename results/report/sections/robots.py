"""Success in a task by the robot that plays it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from robogauntlet.results.analysis.tables import CellRow, Tables, Tally
from robogauntlet.results.report.blocks import Block, Paragraph, Table
from robogauntlet.results.report.formatting import TextTable, points, share
from robogauntlet.results.report.section import Page, Section
from robogauntlet.results.statistics.rates import Estimate, rate_difference
from robogauntlet.suites.episode import AT, Condition

HEADER = ("task", "policy", "robot", "success", "to the first robot (points)")
EXPLANATION = (
    "Clean episodes of tasks that several robots play. Differences are of success rates, in percentage points, with "
    "Newcombe's interval (95 %) for separate trials: seeds are not paired, since objects may lie elsewhere for another "
    "robot."
)


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


def robot_table(rows: Sequence[RobotRow]) -> TextTable:
    """Success of each policy and robot, and its difference to the first robot's."""
    lines = ((row.task, row.policy, row.robot, share(row.tally), points(row.difference)) for row in rows)
    return TextTable(HEADER, tuple(lines), 3)


def _blocks(rows: Sequence[RobotRow], page: Page) -> Iterator[Block]:
    if rows:
        yield Paragraph(EXPLANATION)
        yield Table(robot_table(rows), "Success by robot")


SECTIONS = (
    Section(
        name="robots",
        title="By robot",
        build=lambda source: compare_robots(source.document.robots, source.tables),
        type=tuple[RobotRow, ...],
        blocks=_blocks,
    ),
)
