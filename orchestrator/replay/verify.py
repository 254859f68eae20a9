"""Checks a run against itself: the hash of its rows, and the outcomes of a random sample that is replayed."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.replay.replay import NotReplayed, replay, replay_rows
from robogauntlet.results.record import EpisodeResult, Status, outcome_row, rows_hash
from robogauntlet.suites.episode import content_hash

FAILED = "could not be played again"


@dataclass(frozen=True)
class StoreSample:
    """The size and hash of a store, and a random sample of its rows."""

    rows: int
    rows_hash: str
    sample: tuple[EpisodeResult, ...]
    """Successes and failures, in the order of their tasks; errors are not replayed."""


@dataclass(frozen=True)
class ReplayCheck:
    """A row that was replayed."""

    row: EpisodeResult
    differences: tuple[str, ...]
    """A line for each outcome field that differs, or why the row could not be replayed."""


def sample_rows(rows: Iterable[EpisodeResult], size: int, seed: int) -> StoreSample:
    """Hash rows in any order, and draw those with the smallest hashes of seed and id in the same pass."""
    sample: list[tuple[int, str, EpisodeResult]] = []
    count = 0

    def outcomes() -> Iterator[tuple[Any, ...]]:
        nonlocal count
        for row in rows:
            count += 1
            if row.status != Status.ERROR and size:
                rank = -int(content_hash([seed, row.episode_id]), 16)
                keep = heapq.heappush if len(sample) < size else heapq.heappushpop
                keep(sample, (rank, row.episode_id, row))
            yield outcome_row(row)

    digest = rows_hash(outcomes())
    sampled = sorted((row for _, _, row in sample), key=lambda row: (row.task, row.policy, row.axis, row.seed))
    return StoreSample(count, digest, tuple(sampled))


def check_rows(
    rows: Sequence[EpisodeResult], sources: Mapping[str, PolicySource], environments: EnvironmentResolver
) -> Iterator[ReplayCheck]:
    """Replay rows and compare. Ray must be running; for the arguments see `replay_rows`.

    Raises:
        RayLost: Ray itself has died.
    """
    for row, lines in replay_rows(rows, sources, environments, _check):
        yield ReplayCheck(row, (f"{FAILED}: {lines.reason}",) if isinstance(lines, NotReplayed) else lines)


def _check(row: EpisodeResult, runner: EpisodeRunner) -> tuple[str, ...]:
    replayed = replay(row, runner)
    return (f"{FAILED}: {replayed.result.error}",) if replayed.result.error else replayed.differences
