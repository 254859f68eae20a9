"""Selects episodes of a run for videos and conditions for snapshots. Renders nothing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from itertools import zip_longest

from robogauntlet.results.media_paths import SHARED_BY
from robogauntlet.results.record import EpisodeResult, Status
from robogauntlet.suites.episode import CLEAN, Cell, Condition, View


@dataclass(frozen=True)
class Snapshot:
    """The first observation of an episode of a task under a condition, to be rendered."""

    task: str
    condition: Condition
    seed: int
    view: View

    @property
    def simulator(self) -> str:
        """Name of the task's simulator."""
        return self.task.partition("/")[0]


def representative_episodes(rows: Iterable[EpisodeResult], recorded: Collection[str] = ()) -> list[EpisodeResult]:
    """The first success and the first failure of each policy on each task: clean ones first, then those with a video.

    `recorded` are the ids of episodes with a video.
    """
    return _first(rows, lambda row: (row.task, row.policy, row.status), recorded)


def first_failures(
    rows: Iterable[EpisodeResult], policies: Collection[str], recorded: Collection[str] = ()
) -> list[EpisodeResult]:
    """The failure of each of these policies, or of all if there are none, that shows most; as above."""
    failures = (row for row in rows if row.status == Status.FAILURE and (not policies or row.policy in policies))
    return _first(failures, lambda row: (row.policy,), recorded)


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
        if row.episode.condition.is_on_scale
        and row.status == Status.FAILURE
        and (row.policy, row.task, row.seed) in solved
    )
    return _first(failures, lambda row: (row.axis, row.simulator, row.policy))


def shared_by(row: EpisodeResult) -> tuple[str, ...]:
    """The fields `SHARED_BY` of a row: equal for rows that one video shows."""
    return tuple(getattr(row, name) for name in SHARED_BY)


def recording_order(rows: Iterable[EpisodeResult]) -> list[EpisodeResult]:
    """One row for each video that these rows need, the most informative first.

    Tasks take turns, in every second round in reverse, so that one that is open goes on. In a task each outcome comes
    with the video that shows the most policies, then each with its next one.
    """
    videos: dict[tuple[str, ...], list[EpisodeResult]] = {}
    for row in rows:
        videos.setdefault(shared_by(row), []).append(row)
    ranks: Counter[tuple[str, str]] = Counter()
    by_task: dict[str, list[tuple[int, EpisodeResult]]] = {}
    for row, *_ in sorted(videos.values(), key=len, reverse=True):
        by_task.setdefault(row.task, []).append((ranks[row.task, row.status], row))
        ranks[row.task, row.status] += 1
    queues = (sorted(by_task[task], key=lambda ranked: ranked[0]) for task in sorted(by_task))
    rounds = enumerate(zip_longest(*queues))
    return [ranked[1] for i, turn in rounds for ranked in turn[:: -1 if i % 2 else 1] if ranked is not None]


def condition_snapshots(cells: Iterable[Cell], seed: int) -> list[Snapshot]:
    """Snapshots of an axis' planned severities and the clean condition, on the first task per simulator and axis."""
    tasks: dict[tuple[str, str], str] = {}
    snapshots: dict[Snapshot, None] = {}
    for cell in cells:
        axis = cell.condition.axis
        if cell.condition.is_on_scale and tasks.setdefault((cell.simulator, axis), cell.task) == cell.task:
            for condition in (Condition(), cell.condition):
                snapshots[Snapshot(cell.task, condition, seed, cell.protocol.view)] = None
    return list(snapshots)


def _first(
    rows: Iterable[EpisodeResult], group: Callable[[EpisodeResult], tuple[str, ...]], recorded: Collection[str] = ()
) -> list[EpisodeResult]:
    def order(row: EpisodeResult) -> tuple[int, str, bool, int, str]:
        return row.severity, row.axis, row.episode_id not in recorded, row.seed, row.task

    selected: dict[tuple[str, ...], EpisodeResult] = {}
    for row in rows:
        if row.status != Status.ERROR:
            selected[group(row)] = min(selected.get(group(row), row), row, key=order)
    return [selected[key] for key in sorted(selected)]
