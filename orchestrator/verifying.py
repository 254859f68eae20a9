"""Checks a run against itself: the hash of its rows, and a random sample of its episodes played again."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

from adapters import catalog
from orchestrator.beside import Ended, beside
from orchestrator.environments.homes import Homes
from orchestrator.replay import differences, episode_of
from orchestrator.runner import EpisodeRunner
from orchestrator.sources import PolicySource
from results.record import EpisodeResult, Status, outcome_row, rows_hash
from suites.vocabulary import content_hash


@dataclass(frozen=True)
class Read:
    """What a store holds."""

    rows: int
    rows_hash: str
    sample: tuple[EpisodeResult, ...]
    """Successes and failures, in the order of their tasks; errors are not played again."""


@dataclass(frozen=True)
class Checked:
    """A row that was played again."""

    row: EpisodeResult
    differences: tuple[str, ...]
    """A line for each outcome field that came out differently, or why it could not be played."""


Listener = Callable[[Checked], None]
"""Told after every episode that was played again."""


def read(rows: Iterable[EpisodeResult], size: int, seed: int) -> Read:
    """Hash the rows, and draw a sample of them in the same pass.

    Args:
        rows: In any order: the sample are the rows whose ids have the least hashes with the seed.
        size: Of the sample, if there are as many rows.
        seed: Of the draw.
    """
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
    chosen = sorted((row for _, _, row in sample), key=lambda row: (row.task, row.policy, row.axis, row.seed))
    return Read(count, digest, tuple(chosen))


def play_again(
    rows: Sequence[EpisodeResult],
    sources: Mapping[str, PolicySource],
    listener: Listener,
    homes: Homes | None = None,
) -> list[Checked]:
    """Play rows again, a process per simulator beside each other. Ray must be running.

    Args:
        rows: Successes and failures.
        sources: The run's policies.
        listener: See `Listener`.
        homes: In which environment each simulator runs.

    Raises:
        RayLost: Ray itself has died.
    """
    by_simulator: dict[str, list[EpisodeResult]] = {}
    for row in rows:
        by_simulator.setdefault(row.simulator, []).append(row)
    waiting = {simulator: iter(own) for simulator, own in by_simulator.items()}
    checked = []
    homes = homes or Homes()
    reasons = {name: homes.missing_reason(catalog.find(name)) for name in by_simulator}
    arguments = {name: (own, dict(sources)) for name, own in by_simulator.items() if reasons[name] is None}
    absent = ((name, Ended(reason)) for name, reason in reasons.items() if reason is not None)
    for simulator, found in chain(absent, beside(_again, arguments, homes)):
        if isinstance(found, Ended):
            came = [Checked(row, (f"could not be played again: {found.reason}",)) for row in waiting[simulator]]
        else:
            came = [Checked(next(waiting[simulator]), tuple(found))]
        checked += came
        for one in came:
            listener(one)
    return checked


def _again(rows: Sequence[EpisodeResult], sources: Mapping[str, PolicySource]) -> Iterator[list[str]]:
    runner = EpisodeRunner(sources)
    try:
        for row in rows:
            found = runner.play_one(episode_of(row))
            yield [f"could not be played again: {found.error}"] if found.error else differences(row, found)
    finally:
        runner.close()
