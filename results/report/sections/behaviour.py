"""How robots move in the clean episodes of a run, per policy and task."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robogauntlet.results.record import BEHAVIOUR, Status
from robogauntlet.results.report.blocks import Block, Heading, Paragraph, Table, Terms
from robogauntlet.results.report.formatting import NOTHING, TextTable, count, percent
from robogauntlet.results.report.section import Page, Section
from robogauntlet.results.run_document import RunDocument
from robogauntlet.suites.episode import CLEAN

if TYPE_CHECKING:
    import pandas as pd

TERMS = {
    "path length": "Of the tool centre point.",
    "time to success": "Simulated time until the task's predicate began to hold for good.",
    "smoothness": "Spectral arc length of the tool's speed, without a unit: lower is jerkier.",
    "progress": "Share of the distance to the goal that was covered at the end; below 0 if the distance grew, at least "
    "-1.",
    "contact": "With what is neither the robot itself nor an object of the task: share of control steps, and largest "
    "force of any episode.",
    "limits": "Share of control steps within 0.01 rad of a joint limit, and of those with the tool more than 0.2 m "
    "outside the box of the start positions.",
}
MEASURES = tuple(name for name in BEHAVIOUR if name != "failure")
"""Fields of the record that are numbers about the behaviour."""
COLUMNS = ("simulator", "task", "policy", "policy_digest", "axis", "status", "steps", *MEASURES)
"""Fields of the record that are needed."""
MOST_ROWS = 24
"""Rows up to which each task has one; of more, each simulator."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and quartiles of a number over episodes."""

    median: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True)
class BehaviourRow:
    """The clean episodes of one policy on a task, or on all tasks of a simulator. None: not measured."""

    policy: str
    simulator: str
    task: str | None
    """None for all tasks of the simulator."""
    successes: int
    episodes: int
    """Successes and failures."""
    path_length: Spread | None
    """Of the tool centre point, in successes (m)."""
    time_to_success: Spread | None
    """In successes (s of simulated time)."""
    smoothness: Spread | None
    """Spectral arc length in successes; lower is jerkier."""
    progress: Spread | None
    """Share of the distance to the goal covered at the end, from -1 to 1."""
    progress_of_failures: Spread | None
    gripper_openings: Spread | None
    contact_steps: float | None
    """Share of the control steps with a contact that is not part of the task."""
    contact_force: float | None
    """The largest force of such a contact in any episode (N)."""
    joint_limit_steps: float | None
    """Share of the control steps at a joint limit."""
    workspace_steps: float | None
    """Share of the control steps with the tool outside the workspace."""


def build_behaviour(document: RunDocument, frame: pd.DataFrame) -> tuple[BehaviourRow, ...] | None:
    """Summarise the clean episodes of a run from its rows with the columns `COLUMNS`; None if none was measured.

    Rows are in the order of the plan.
    """
    clean = (frame["axis"].astype(str) == CLEAN) & frame["status"].astype(str).isin([Status.SUCCESS, Status.FAILURE])
    measured = list(MEASURES)
    rows = frame[clean & frame[measured].notna().any(axis=1)]
    if rows.empty:
        return None
    rows = rows.assign(**{name: rows[name].astype(float) for name in measured})
    names = dict.fromkeys((cell.policy, cell.policy_digest, cell.simulator, cell.task) for cell in document.plan)
    many = len(names) > MOST_ROWS
    wanted = dict.fromkeys(
        (policy, digest, simulator, None if many else task) for policy, digest, simulator, task in names
    )
    made = []
    for policy, digest, simulator, task in wanted:
        column, value = ("simulator", simulator) if task is None else ("task", task)
        own = rows[(rows["policy_digest"] == digest) & (rows[column] == value)]
        if len(own):
            made.append(_row(policy, simulator, task, own))
    return tuple(made) or None


def _row(policy: str, simulator: str, task: str | None, rows: pd.DataFrame) -> BehaviourRow:
    won = rows["status"] == Status.SUCCESS
    successes = rows[won]
    return BehaviourRow(
        policy=policy,
        simulator=simulator,
        task=task,
        successes=len(successes),
        episodes=len(rows),
        path_length=_spread(successes["path_length"]),
        time_to_success=_spread(successes["time_to_success"]),
        smoothness=_spread(successes["smoothness"]),
        progress=_spread(rows["progress"]),
        progress_of_failures=_spread(rows["progress"][~won]),
        gripper_openings=_spread(rows["gripper_openings"]),
        contact_steps=_share(rows, "contact_steps"),
        contact_force=float(force) if (force := rows["contact_force"].max()) == force else None,
        joint_limit_steps=_share(rows, "joint_limit_steps"),
        workspace_steps=_share(rows, "workspace_steps"),
    )


def _spread(values: pd.Series) -> Spread | None:
    known = values.dropna()
    if known.empty:
        return None
    lower, median, upper = known.quantile([0.25, 0.5, 0.75]).tolist()
    return Spread(median, lower, upper)


def _share(rows: pd.DataFrame, name: str) -> float | None:
    """Share of the control steps, over the episodes in which it was measured."""
    known = rows[rows[name].notna()]
    steps = int(known["steps"].sum())
    return float(known[name].sum() / steps) if steps else None


def success_table(rows: Sequence[BehaviourRow]) -> TextTable:
    """Path, time and smoothness of the successes."""
    header = ("task", "policy", "successes", "path length (m)", "time to success (s)", "smoothness")
    shown = (
        (
            count(row.successes),
            _spread_text(row.path_length),
            _spread_text(row.time_to_success),
            _spread_text(row.smoothness),
        )
        for row in rows
    )
    return _measured(header, rows, shown)


def episode_table(rows: Sequence[BehaviourRow]) -> TextTable:
    """Progress, gripper, contacts and limits in all episodes, successes and failures."""
    header = (
        *("task", "policy", "episodes", "progress", "progress of failures", "gripper openings"),
        *("contact (steps)", "largest force (N)", "at a joint limit (steps)", "outside workspace (steps)"),
    )
    shown = (
        (
            count(row.episodes),
            _spread_text(row.progress),
            _spread_text(row.progress_of_failures),
            _spread_text(row.gripper_openings, digits=0),
            percent(row.contact_steps),
            NOTHING if row.contact_force is None else f"{row.contact_force:.1f}",
            percent(row.joint_limit_steps),
            percent(row.workspace_steps),
        )
        for row in rows
    )
    return _measured(header, rows, shown)


def _measured(header: tuple[str, ...], rows: Sequence[BehaviourRow], shown: Iterable[tuple[str, ...]]) -> TextTable:
    """The table without columns in which nothing was measured."""
    lines = [
        (row.task or f"all of {row.simulator}", row.policy, *values) for row, values in zip(rows, shown, strict=True)
    ]
    kept = [place for place, column in enumerate(zip(*lines, strict=True)) if set(column) != {NOTHING}]
    return TextTable(tuple(header[i] for i in kept), tuple(tuple(line[i] for i in kept) for line in lines), 2)


def _spread_text(spread: Spread | None, digits: int = 2) -> str:
    """`0.52 (0.44 to 0.61)`."""
    if spread is None:
        return NOTHING
    median, lower, upper = (
        f"{round(value, digits) + 0.0:.{digits}f}" for value in (spread.median, spread.lower, spread.upper)
    )
    return f"{median} ({lower} to {upper})"


def _blocks(rows: Sequence[BehaviourRow], page: Page) -> Iterator[Block]:
    yield Paragraph("Clean episodes: medians, with quartiles in parentheses.")
    yield Terms(TERMS)
    yield Heading("Successes")
    yield Table(success_table(rows), "Movement in successes")
    yield Heading("Successes and failures")
    yield Table(episode_table(rows), "Movement in successes and failures")


SECTIONS = (
    Section(
        name="behaviour",
        title="How it moves",
        columns=COLUMNS,
        build=lambda source: build_behaviour(source.document, source.rows),
        type=tuple[BehaviourRow, ...],
        blocks=_blocks,
    ),
)
