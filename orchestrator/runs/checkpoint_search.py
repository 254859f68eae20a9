"""Searches ordered checkpoints for the first that became worse, in rounds. Pure: from outcomes to work.

The checkpoints are policies of one suite, of which only the episodes are played that the search asks for
(`results.statistics.bisection`). The search is repeated from its beginning over the stored outcomes after each round,
so that it depends on these alone, and a run that is continued goes on where it was.

The episodes of all tasks on a seed follow each other, and evidence is evaluated after whole seeds, so that the tasks
count alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robogauntlet.orchestrator.runs.adaptive_stopping import Outcomes, Progression, key_of
from robogauntlet.results.record import Status
from robogauntlet.results.statistics.bisection import (
    BATCH,
    Bisection,
    EndsDoNotDiffer,
    Question,
    bisect_checkpoints,
    needed_evidence,
)
from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.suites.episode import Cell
from robogauntlet.support.text import counted

GROWTH = 4
"""A round plays at least the seeds that are known divided by this, in whole batches, since each starts workers."""
VERDICTS = {str(Status.SUCCESS): 1.0, str(Status.FAILURE): 0.0}


@dataclass(frozen=True)
class CheckpointCounts:
    """The episodes of a checkpoint."""

    checkpoint: str
    policy: str
    """Its name in the run."""
    successes: int
    failures: int
    errors: int
    is_worse: bool | None
    """Whether it is worse than the first by half of the difference of the ends; None if that was not decided."""

    def __str__(self) -> str:
        played = self.successes + self.failures
        return f"{self.checkpoint} {self.successes:,} of {played:,}" if played else f"{self.checkpoint} not played"


@dataclass(frozen=True)
class CheckpointSearchResult:
    """The first checkpoint that is worse than the good one by at least half of the difference of the ends."""

    first_worse: str | None
    """None if the seeds did not decide it."""
    last_good: str
    """The checkpoint before it; or the last of which it was decided that it is not worse."""
    candidates: tuple[str, ...]
    """The first worse checkpoint is one of these."""
    confidence: float
    """Probability with which this is so."""
    episodes: int
    """Episodes played."""
    all_episodes: int
    """Episodes of all checkpoints on all seeds."""
    checkpoints: tuple[CheckpointCounts, ...]
    """In their order, the good one first and the bad one last."""


class CheckpointSearch:
    """Chooses the episodes of each round (`run.Rounds`), and knows the result when no round is left.

    Args:
        checkpoints: What the checkpoints are called in messages, to the name of their policy in the suite; the good one
            first, the bad one last.
        seeds: Largest number of seeds per checkpoint and task, from 0.
        on_round: Receives a line about each round.
    """

    def __init__(self, checkpoints: Mapping[str, str], seeds: int, on_round: Callable[[str], None]) -> None:
        self._names, self._policies, self._seeds = [*checkpoints], [*checkpoints.values()], seeds
        self._on_round = on_round
        self._cells: list[list[Cell]] = [[] for _ in checkpoints]
        self._outcomes: Outcomes = {}
        self._found: Bisection | EndsDoNotDiffer | None = None

    def __call__(self, cells: Sequence[Cell], outcomes: Outcomes) -> Progression:
        """The work of the next round; none if the search is over or cannot go on."""
        self._cells = [[cell for cell in cells if cell.policy == policy] for policy in self._policies]
        self._outcomes = outcomes
        tasks = len(self._cells[0])
        if not tasks or self.unplayable is not None:
            return Progression(planned=self._planned({}))
        batch = math.ceil(BATCH / tasks)
        asked: dict[int, range] = {}
        known = 0

        def play(checkpoint: int, items: range) -> NDArray[np.float64]:
            nonlocal known
            values = self._values(checkpoint, _seeds(items, tasks))
            if values is None:
                asked.setdefault(checkpoint, items)
                return np.full(len(items), np.nan)
            known = max(known, items.stop // tasks)
            return values

        last = len(self._names) - 1
        found: Bisection | EndsDoNotDiffer
        try:
            found = bisect_checkpoints(last, play, batch=batch * tasks, most_seeds=self._seeds * tasks)
        except EndsDoNotDiffer as ends:
            found = ends
        blocks = _together([*asked.items()], tasks, most=self._seeds, ahead=known // GROWTH // batch * batch)
        self._found = None if blocks else found
        work = [
            (cell, [seed for seed in seeds if seed not in outcomes.get(key_of(cell), {})])
            for number, seeds in blocks.items()
            for cell in self._cells[number]
        ]
        if blocks:
            question = found.question if isinstance(found, EndsDoNotDiffer) else found.questions[-1]
            self._on_round(self._line(question, sum(len(lacking) for _, lacking in work)))
        return Progression([one for one in work if one[1]], self._planned(blocks))

    @property
    def unplayable(self) -> str | None:
        """A checkpoint without any episode that could be played, if there is one."""
        for number, name in enumerate(self._names):
            successes, failures, errors = self._count(number)
            if errors >= BATCH and not successes + failures:
                return name
        return None

    @property
    def result(self) -> CheckpointSearchResult | None:
        """The result; None if episodes are missing or the ends do not differ."""
        found = self._found
        if not isinstance(found, Bisection):
            return None
        counts = self.counts
        return CheckpointSearchResult(
            first_worse=self._names[found.first_worse] if found.is_found else None,
            last_good=self._names[found.last_good],
            candidates=tuple(self._names[found.last_good + 1 : found.first_worse + 1]),
            confidence=found.confidence,
            episodes=sum(one.successes + one.failures + one.errors for one in counts),
            all_episodes=self._seeds * sum(map(len, self._cells)),
            checkpoints=counts,
        )

    @property
    def alike(self) -> str | None:
        """Why the ends do not differ, once that is so."""
        if not isinstance(self._found, EndsDoNotDiffer):
            return None
        good, bad = self.counts[0], self.counts[-1]
        shown = "not shown to be" if self._found.question.is_worse is None else "shown not to be"
        return (
            f"the ends do not differ: {bad.checkpoint} is {shown} worse than {good.checkpoint} ({bad}, {good}; e-value "
            f"{self._found.question.evidence:.3g}, needed {self._needed:.3g})"
        )

    @property
    def counts(self) -> tuple[CheckpointCounts, ...]:
        """The episodes of each checkpoint."""
        answers = {0: False}
        if isinstance(self._found, Bisection):
            answers |= {one.checkpoint: one.is_worse for one in self._found.questions if one.is_worse is not None}
        return tuple(
            CheckpointCounts(name, policy, *self._count(number), answers.get(number))
            for number, (name, policy) in enumerate(zip(self._names, self._policies, strict=True))
        )

    @property
    def _needed(self) -> float:
        return needed_evidence(len(self._names) - 1, ALPHA)

    def _values(self, checkpoint: int, seeds: range) -> NDArray[np.float64] | None:
        """The outcomes on all tasks of each seed in turn; None if one is missing."""
        played = [self._outcomes.get(key_of(cell), {}) for cell in self._cells[checkpoint]]
        if not all(seed in one for seed in seeds for one in played):
            return None
        return np.array([VERDICTS.get(one[seed], np.nan) for seed in seeds for one in played])

    def _count(self, checkpoint: int) -> tuple[int, int, int]:
        statuses = [
            status for cell in self._cells[checkpoint] for status in self._outcomes.get(key_of(cell), {}).values()
        ]
        successes, failures = (statuses.count(verdict) for verdict in VERDICTS)
        return successes, failures, len(statuses) - successes - failures

    def _planned(self, blocks: Mapping[int, range]) -> dict[Cell, int]:
        """Seeds of each cell that are played or will be in this round."""
        return {
            cell: len({*self._outcomes.get(key_of(cell), {}), *blocks.get(number, ())})
            for number, cells in enumerate(self._cells)
            for cell in cells
        }

    def _line(self, question: Question, episodes: int) -> str:
        counts = self.counts
        sides = [*dict.fromkeys((counts[question.checkpoint], counts[0], counts[-1]))]
        return (
            f"is {sides[0].checkpoint} worse? {', '.join(map(str, sides))}; e-value {question.evidence:.3g}, needed "
            f"{self._needed:.3g}; next {counted(episodes, 'episode')}"
        )


def _seeds(items: range, tasks: int) -> range:
    """The seeds of items, of which each seed has one per task."""
    return range(items.start // tasks, items.stop // tasks)


def _together(asked: Sequence[tuple[int, range]], tasks: int, *, most: int, ahead: int) -> dict[int, range]:
    """The seeds of the checkpoints that the first evaluation without an outcome asked for; at least `ahead` seeds."""
    blocks = {number: _seeds(items, tasks) for number, items in asked if items.stop == asked[0][1].stop}
    first = min((seeds.start for seeds in blocks.values()), default=0)
    return {number: range(seeds.start, min(max(seeds.stop, first + ahead), most)) for number, seeds in blocks.items()}
