"""Selects episodes of a run for videos and conditions for snapshots. Renders nothing."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

from robogauntlet.orchestrator.episodes.first_observation import Snapshot
from robogauntlet.results.record import EpisodeResult, Status
from robogauntlet.suites.episode import CLEAN, CONTROLS, Cell, Condition

NO_AXIS = (CLEAN, *CONTROLS)
"""Conditions that belong to no axis."""


def representative_episodes(rows: Iterable[EpisodeResult]) -> list[EpisodeResult]:
    """The first success and the first failure of each policy on each task: clean ones first, then by seed."""
    return _first(rows, lambda row: (row.task, row.policy, row.status))


def new_failures(rows: Callable[[], Iterable[EpisodeResult]], policies: Collection[str]) -> list[EpisodeResult]:
    """For each policy, axis and simulator the failure of lowest severity, then seed, whose clean episode succeeded.

    `rows` returns a new iterator over the run's rows at every call.
    """
    solved = {
        (row.policy, row.task, row.seed)
        for row in rows()
        if row.axis == CLEAN and row.status == Status.SUCCESS and row.policy in policies
    }
    failures = (
        row
        for row in rows()
        if row.axis not in NO_AXIS and row.status == Status.FAILURE and (row.policy, row.task, row.seed) in solved
    )
    return _first(failures, lambda row: (row.axis, row.simulator, row.policy))


def condition_snapshots(cells: Iterable[Cell], seed: int) -> list[Snapshot]:
    """Snapshots of an axis' planned severities and the clean condition, on the first task per simulator and axis."""
    tasks: dict[tuple[str, str], str] = {}
    snapshots: dict[Snapshot, None] = {}
    for cell in cells:
        axis = cell.condition.axis
        if axis not in NO_AXIS and tasks.setdefault((cell.simulator, axis), cell.task) == cell.task:
            for condition in (Condition(), cell.condition):
                snapshots[Snapshot(cell.task, condition, seed, cell.protocol.view)] = None
    return list(snapshots)


def _first(rows: Iterable[EpisodeResult], group: Callable[[EpisodeResult], tuple[str, ...]]) -> list[EpisodeResult]:
    def order(row: EpisodeResult) -> tuple[int, str, int, str]:
        return row.severity, row.axis, row.seed, row.task

    selected: dict[tuple[str, ...], EpisodeResult] = {}
    for row in rows:
        if row.status != Status.ERROR:
            selected[group(row)] = min(selected.get(group(row), row), row, key=order)
    return [selected[key] for key in sorted(selected)]
