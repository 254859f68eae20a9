"""Tables of how robots move, for `report.md` and `report.html`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from robogauntlet.results.analysis.behaviour import BehaviourRow, Spread
from robogauntlet.results.report.formatting import NOTHING, TextTable, count, percent


def success_table(rows: Sequence[BehaviourRow]) -> TextTable:
    """Path, time and smoothness of the successes."""
    header = ("task", "policy", "successes", "path length (m)", "time to success (s)", "smoothness")
    shown = (
        (count(row.successes), _spread(row.path_length), _spread(row.time_to_success), _spread(row.smoothness))
        for row in rows
    )
    return _table(header, rows, shown)


def episode_table(rows: Sequence[BehaviourRow]) -> TextTable:
    """Progress, gripper, contacts and limits in all episodes, successes and failures."""
    header = (
        *("task", "policy", "episodes", "progress", "progress of failures", "gripper openings"),
        *("contact (steps)", "largest force (N)", "at a joint limit (steps)", "outside workspace (steps)"),
    )
    shown = (
        (
            count(row.episodes),
            _spread(row.progress),
            _spread(row.progress_of_failures),
            _spread(row.gripper_openings, digits=0),
            percent(row.contact_steps),
            NOTHING if row.contact_force is None else f"{row.contact_force:.1f}",
            percent(row.joint_limit_steps),
            percent(row.workspace_steps),
        )
        for row in rows
    )
    return _table(header, rows, shown)


def _table(header: tuple[str, ...], rows: Sequence[BehaviourRow], shown: Iterable[tuple[str, ...]]) -> TextTable:
    """The table without columns in which nothing was measured."""
    lines = [
        (row.task or f"all of {row.simulator}", row.policy, *values) for row, values in zip(rows, shown, strict=True)
    ]
    kept = [place for place, column in enumerate(zip(*lines, strict=True)) if set(column) != {NOTHING}]
    return TextTable(tuple(header[i] for i in kept), tuple(tuple(line[i] for i in kept) for line in lines), 2)


def _spread(spread: Spread | None, digits: int = 2) -> str:
    """`0.52 (0.44 to 0.61)`."""
    if spread is None:
        return NOTHING
    median, lower, upper = (
        f"{round(value, digits) + 0.0:.{digits}f}" for value in (spread.median, spread.lower, spread.upper)
    )
    return f"{median} ({lower} to {upper})"
