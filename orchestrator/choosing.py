"""Which episodes of a run are worth a video, and which conditions worth a picture. Nothing is rendered here."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

from results.record import EpisodeResult, Status
from suites.vocabulary import CLEAN, CONTROLS, Cell, Condition, View

UNSHOWN = (CLEAN, *CONTROLS)
"""Conditions along no axis."""


@dataclass(frozen=True)
class Look:
    """What policies see first of a seed of a task under a condition."""

    task: str
    condition: Condition
    seed: int
    view: View


def typical(rows: Iterable[EpisodeResult]) -> list[EpisodeResult]:
    """The first success and the first failure of each policy on each task: clean ones first, then by seed."""
    return _first(rows, lambda row: (row.task, row.policy, row.status))


def fallen(rows: Callable[[], Iterable[EpisodeResult]], policies: Collection[str]) -> list[EpisodeResult]:
    """Of each policy along each axis in each simulator a failure whose clean episode succeeded: the mildest, by seed.

    Args:
        rows: Gives the run's rows anew at every call.
        policies: Names of those in question.
    """
    stood = {
        (row.policy, row.task, row.seed)
        for row in rows()
        if row.axis == CLEAN and row.status == Status.SUCCESS and row.policy in policies
    }
    failures = (
        row
        for row in rows()
        if row.axis not in UNSHOWN and row.status == Status.FAILURE and (row.policy, row.task, row.seed) in stood
    )
    return _first(failures, lambda row: (row.axis, row.simulator, row.policy))


def worth_a_look(cells: Iterable[Cell], seed: int) -> list[Look]:
    """Every planned severity of every axis, on the first task of each simulator that has it, with the clean one."""
    tasks: dict[tuple[str, str], str] = {}
    looks: dict[Look, None] = {}
    for cell in cells:
        axis = cell.condition.axis
        if axis not in UNSHOWN and tasks.setdefault((cell.simulator, axis), cell.task) == cell.task:
            for condition in (Condition(), cell.condition):
                looks[Look(cell.task, condition, seed, cell.protocol.view)] = None
    return list(looks)


def _first(rows: Iterable[EpisodeResult], group: Callable[[EpisodeResult], tuple[str, ...]]) -> list[EpisodeResult]:
    chosen: dict[tuple[str, ...], EpisodeResult] = {}
    for row in rows:
        if row.status != Status.ERROR:
            key = group(row)
            if key not in chosen or _order(row) < _order(chosen[key]):
                chosen[key] = row
    return [chosen[key] for key in sorted(chosen)]


def _order(row: EpisodeResult) -> tuple[int, str, int, str]:
    return row.severity, row.axis, row.seed, row.task
