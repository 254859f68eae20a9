"""What is still to be demonstrated of one task, and what has come back. No Ray, no clock but the one it is given."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable

from policies.training.lerobot import EncodedEpisode
from policies.training.writing import Attempt, DatasetWriter
from results.record import Status
from suites.vocabulary import Cell

FLUSH_BYTES = 32 * 2**20
FLUSH_S = 30.0
TRIES = 3
"""Times that an episode may end its worker before it counts as an error."""

DEATHS_IN_A_ROW = 6
"""Workers that may die one after the other, without an episode between them, before the task is given up."""

Played = tuple[Attempt, EncodedEpisode | None]


class Lane:
    """One task's seeds, played in any order and committed in theirs.

    No more seeds are handed out than would complete the task if all of them succeeded, so that the kept episodes are
    the first successes by seed, whoever played them and when.
    """

    def __init__(
        self,
        cell: Cell,
        episodes: int,
        first_seed: int,
        writer: DatasetWriter,
        *,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Args: cell: Who plays what; episodes: successes wanted; writer: has what was committed before."""
        self.cell, self.episodes, self.writer = cell, episodes, writer
        self.reason: str | None = None
        """Why nothing more is played although episodes are missing."""
        self._now = now
        self._next = self._frontier = first_seed + len(writer.attempts)
        self._out: set[int] = set()
        self._lost: list[int] = []
        self._deaths: Counter[int] = Counter()
        self._deaths_in_a_row = 0
        self._early: dict[int, Played] = {}
        self._ready: list[Played] = []
        self._flushed_at = now()
        self._counts = Counter(attempt.status for attempt in writer.attempts)

    @property
    def task(self) -> str:
        """`simulator/task`."""
        return self.cell.task

    @property
    def simulator(self) -> str:
        """The part of the task's name before the slash."""
        return self.cell.simulator

    @property
    def kept(self) -> int:
        """Successes so far."""
        return self._counts[Status.SUCCESS]

    @property
    def rejected(self) -> int:
        """Failures so far."""
        return self._counts[Status.FAILURE]

    @property
    def errors(self) -> int:
        """Episodes that could not be played so far."""
        return self._counts[Status.ERROR]

    @property
    def wanted(self) -> int:
        """Seeds that can be handed out now."""
        return 0 if self.reason else max(0, self.episodes - self.kept - len(self._out))

    @property
    def open(self) -> bool:
        """Whether there is something to play or to wait for."""
        return not self.reason and self.kept < self.episodes

    def lease(self, most: int) -> tuple[int, ...]:
        """Seeds to play now."""
        seeds = []
        for _ in range(min(most, self.wanted)):
            if self._lost:
                seeds.append(self._lost.pop(0))
            else:
                seeds.append(self._next)
                self._next += 1
        self._out.update(seeds)
        return tuple(seeds)

    def take(self, played: Played) -> None:
        """An episode came back."""
        self._deaths_in_a_row = 0
        self._settle(played)

    def _settle(self, played: Played) -> None:
        attempt = played[0]
        self._out.discard(attempt.seed)
        self._counts[attempt.status] += 1
        self._early[attempt.seed] = played
        while self._frontier in self._early:
            self._ready.append(self._early.pop(self._frontier))
            self._frontier += 1
        limit = 3 * self.episodes + 20
        if self.kept < self.episodes and self._counts.total() >= limit:
            latest = f"; latest error: {attempt.error}" if attempt.error else ""
            self.give_up(f"only {self.kept} of {self._counts.total()} episodes succeeded{latest}")

    def lose(self, seeds: tuple[int, ...], reason: str) -> None:
        """A worker died with these seeds to go, the first of them begun."""
        self._out.difference_update(seeds)
        self._lost = sorted([*self._lost, *seeds])
        if seeds:
            self._deaths[seeds[0]] += 1
            if self._deaths[seeds[0]] >= TRIES:
                self._lost.remove(seeds[0])
                self._settle((Attempt(seeds[0], Status.ERROR, 0, f"{reason}, {TRIES} times"), None))
        self._deaths_in_a_row += 1
        if self._deaths_in_a_row >= DEATHS_IN_A_ROW:
            self.give_up(f"{reason}, {DEATHS_IN_A_ROW} times in a row")

    def give_up(self, reason: str) -> None:
        """Hand out no more seeds."""
        self.reason = self.reason or reason

    def flush_if_due(self) -> None:
        """Commit, if much or old work is waiting or the lane is complete.

        Raises:
            OSError: The disk is full, or the like.
        """
        size = sum(episode.size for _, episode in self._ready if episode is not None)
        late = self._now() - self._flushed_at > FLUSH_S
        if self._ready and (size > FLUSH_BYTES or late or not self.open):
            self.flush()

    def flush(self) -> None:
        """Commit what came back without a gap; what came before its turn is played again another time."""
        if self._ready:
            ready, self._ready = self._ready, []
            self.writer.commit(
                [attempt for attempt, _ in ready], [episode for _, episode in ready if episode is not None]
            )
        self._flushed_at = self._now()


def fair_share(lane: Lane, workers: int, most: int) -> int:
    """Seeds for one of several workers: few enough that the others have some too."""
    return max(1, min(most, math.ceil(lane.wanted / workers)))
