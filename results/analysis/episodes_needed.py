"""How many seeds per task a suite needs, for an interval of a given width or to detect a given difference.

Intervals are those of the tables (`tables`): Wilson's of all clean episodes of a policy, and of those of a task.
Differences are tested as `pairwise` tests them: McNemar's exact test of the clean pairs of all tasks, or of a task, at
alpha divided by the number of tests that Holm's method adjusts together, which is what it asks of the smallest p-value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from robogauntlet.results.record import Status
from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.results.statistics.pairs import Pairs
from robogauntlet.results.statistics.rates import CONFIDENCE
from robogauntlet.results.statistics.sample_size import (
    detectable_difference,
    half_width,
    independent_discordance,
    mcnemar_power,
    pairs_for_power,
    shrunk_share,
    trials_for_half_width,
)
from robogauntlet.suites.schema import CompareEntry

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("policy_digest", "task", "axis", "severity", "seed", "status", "wall_s")
"""Fields of the record that are needed of stored episodes."""
WIDTH, DIFFERENCE = "width", "difference"
"""Goals: an interval of a given width, a difference that is detected."""
WORST_RATE = 0.5


@dataclass(frozen=True)
class SuiteSize:
    """What of a suite decides how many seeds it needs."""

    policies: tuple[tuple[str, str], ...]
    """Name and digest of each."""
    tasks: tuple[str, ...]
    seeds: int
    """Per task."""
    cells: tuple[tuple[str, str, str, int], ...]
    """Policy digest, task, axis and severity of each cell."""
    comparison: CompareEntry | None = None
    most_seeds: int | None = None
    """Seeds per task that start differently; None without a limit."""

    def pairs(self) -> list[tuple[int, int]]:
        """Positions of the policies of each comparison: with the baseline of the suite, else any two."""
        names = [name for name, _ in self.policies]
        sides = self.comparison
        if sides is not None and sides.baseline in names:
            others = [names.index(name) for name in sides.others if name in names]
            if others:
                return [(other, names.index(sides.baseline)) for other in others]
        return list(combinations(range(len(names)), 2))

    def parts(self) -> int:
        """Tasks, and simulators with several tasks if there are several simulators, which a comparison tests."""
        simulators = [task.partition("/")[0] for task in self.tasks]
        several = {name for name in simulators if simulators.count(name) > 1} if len(set(simulators)) > 1 else set()
        return len(self.tasks) + len(several)


@dataclass(frozen=True, slots=True)
class Assumed:
    """A share that was assumed, and where it is from."""

    share: float
    source: str


@dataclass(frozen=True, slots=True)
class SeedsNeeded:
    """The answer to one question."""

    goal: str
    """`WIDTH` or `DIFFERENCE`."""
    target: float
    """Half of the interval's width, or the true difference, as a share."""
    tasks: int
    """Tasks over which the rates are taken: all, or 1."""
    assumed: Assumed
    """The success rate, or the share of pairs that disagree."""
    alpha: float
    """1 minus the interval's confidence, or the largest p-value that counts."""
    seeds: int | None
    """Seeds per task that are needed; None if they are more than there are."""
    episodes: int | None
    """Episodes of the suite with this number of seeds."""
    worker_s: float | None
    """Wall time of these episodes in one worker, without building and loading (s); None if it is not known."""
    reached: float | None
    """Half of the width, or the difference detected with a power of 0.8, with the seeds of the suite."""
    power: float | None
    """Probability of detecting the difference with the seeds of the suite; None for a width."""
    is_enough: bool
    """Whether the seeds of the suite are enough."""
    most_seeds: int | None = None
    """Seeds per task that there are, if there is a limit."""


@dataclass(frozen=True)
class Stored:
    """Clean outcomes and times of the episodes of a run."""

    outcomes: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    """Task to its outcomes, 1, 0 or NaN, with a row per seed and a column per policy digest."""
    seconds: Mapping[tuple[str, str, str, int], float] = field(default_factory=dict)
    """Mean wall time of an episode of a cell (s)."""

    @classmethod
    def from_rows(cls, rows: pd.DataFrame) -> Stored:
        """Read the rows of a run, columns `COLUMNS`; errors are left out."""
        own = rows[rows["status"] != str(Status.ERROR)]
        own = own.assign(success=(own["status"] == str(Status.SUCCESS)).astype(float))
        clean = own[own["severity"] == 0]
        outcomes = {
            str(task): part.pivot(index="seed", columns="policy_digest", values="success")
            for task, part in clean.groupby("task", sort=False, observed=True)
        }
        seconds = own.groupby(["policy_digest", "task", "axis", "severity"], observed=True)["wall_s"].mean()
        return cls(outcomes, {key: float(mean) for key, mean in seconds.items() if mean > 0})

    def counts(self, digest: str) -> dict[str, tuple[int, int]]:
        """Successes and trials of a policy in each task in which it has any."""
        found = {task: table[digest].dropna() for task, table in self.outcomes.items() if digest in table}
        return {task: (int(own.sum()), len(own)) for task, own in found.items() if len(own)}

    def disagreements(self, first: str, second: str) -> dict[str, tuple[int, int]]:
        """Pairs of two policies that disagree, and all their pairs, in each task in which they have any."""
        both = {task: table for task, table in self.outcomes.items() if first in table and second in table}
        found = {task: Pairs.from_outcomes(*(t[one].to_numpy() for one in (first, second))) for task, t in both.items()}
        return {
            task: (pairs.first_only + pairs.second_only, pairs.trials) for task, pairs in found.items() if pairs.trials
        }

    def worker_s(self, size: SuiteSize, seeds: int) -> float | None:
        """Wall time of a suite's episodes with that many seeds (s); cells without episodes take the mean of others."""
        if not self.seconds:
            return None
        mean = float(np.mean(list(self.seconds.values())))
        return seeds * sum(self.seconds.get(cell, mean) for cell in size.cells)


NOTHING = Stored()


def seeds_for_width(
    size: SuiteSize, target: float, *, rate: float | None = None, stored: Stored = NOTHING
) -> list[SeedsNeeded]:
    """Seeds with which the interval of each policy's rate is at most +-target wide, over all tasks and in each task.

    Args:
        size: The suite.
        target: Half of the distance between the ends, a share between 0 and 1.
        rate: The assumed rate; by default that of the stored policy, or task of a policy, which needs most, else 1/2.
        stored: Episodes of the suite.
    """
    found = []
    for tasks in _groups(size):
        assumed = Assumed(WORST_RATE, "the worst case") if rate is None else Assumed(rate, "given")
        if rate is None and (shares := _stored_rates(size, stored, tasks)):
            assumed = min(shares, key=lambda one: abs(one.share - WORST_RATE))
        trials = trials_for_half_width(assumed.share, target)
        reached = half_width(assumed.share, tasks * size.seeds)
        found.append(
            _answer(size, stored, WIDTH, target, tasks, assumed, round(1 - CONFIDENCE, 12), trials, reached, None)
        )
    return found


def seeds_for_difference(
    size: SuiteSize, target: float, *, discordance: float | None = None, stored: Stored = NOTHING
) -> list[SeedsNeeded]:
    """Seeds with which the paired test detects a true difference with a power of 0.8, over all tasks and in a task.

    Args:
        size: The suite, with two policies or more.
        target: The difference of the rates, a share between 0 and 1.
        discordance: The assumed share of pairs that disagree, at least `target`; by default that of the stored
            comparison, or task of a comparison, which needs most, else that of independent outcomes.
        stored: Episodes of the suite.
    """
    found = []
    for tasks in _groups(size):
        assumed = _assumed_discordance(size, target, discordance, stored, tasks)
        tests = len(size.pairs()) * (size.parts() if tasks < len(size.tasks) else 1)
        alpha, now = ALPHA / tests, tasks * size.seeds
        pairs = pairs_for_power(assumed.share, target, alpha, step=tasks)
        power = mcnemar_power(now, assumed.share, target, alpha)
        reached = detectable_difference(now, assumed.share, alpha)
        found.append(_answer(size, stored, DIFFERENCE, target, tasks, assumed, alpha, pairs, reached, power))
    return found


def _groups(size: SuiteSize) -> Sequence[int]:
    """Numbers of tasks over which rates are taken."""
    return (len(size.tasks), 1) if len(size.tasks) > 1 else (1,)


def _answer(
    size: SuiteSize,
    stored: Stored,
    goal: str,
    target: float,
    tasks: int,
    assumed: Assumed,
    alpha: float,
    trials: int,
    reached: float | None,
    power: float | None,
) -> SeedsNeeded:
    seeds = -(-trials // tasks)
    there = size.most_seeds is None or seeds <= size.most_seeds
    return SeedsNeeded(
        goal=goal,
        target=target,
        tasks=tasks,
        assumed=assumed,
        alpha=alpha,
        seeds=seeds if there else None,
        episodes=seeds * len(size.cells) if there else None,
        worker_s=stored.worker_s(size, seeds) if there else None,
        reached=reached,
        power=power,
        is_enough=size.seeds >= seeds,
        most_seeds=size.most_seeds,
    )


def _stored_rates(size: SuiteSize, stored: Stored, tasks: int) -> list[Assumed]:
    """The rate of each policy over all tasks, or in each task."""
    whole = tasks == len(size.tasks)
    return [
        one for name, digest in size.policies for one in _shares(name, "episodes", stored.counts(digest), whole=whole)
    ]


def _assumed_discordance(size: SuiteSize, target: float, given: float | None, stored: Stored, tasks: int) -> Assumed:
    if given is not None:
        return Assumed(given, "given")
    found, whole = [], tasks == len(size.tasks)
    for first, second in size.pairs():
        (name, digest), (other, other_digest) = size.policies[first], size.policies[second]
        counts = stored.disagreements(digest, other_digest)
        found += _shares(f"{name} and {other}", "pairs", counts, whole=whole)
    if not found:
        return Assumed(independent_discordance(target), "as of independent outcomes at rates around 50 %")
    most = max(found, key=lambda one: one.share)
    return most if most.share >= target else Assumed(target, f"no less than the difference; {most.source}")


def _shares(name: str, noun: str, counts: Mapping[str, tuple[int, int]], *, whole: bool) -> list[Assumed]:
    """What to assume of counts (some, all) per task: of their sum, or of each."""
    if not counts:
        return []
    if whole:
        some, trials = map(sum, zip(*counts.values(), strict=True))
        return [Assumed(shrunk_share(some, trials), f"{name}, {some:,} of {trials:,} stored {noun}")]
    return [
        Assumed(shrunk_share(some, trials), f"{name} in {task}, {some:,} of {trials:,} stored {noun}")
        for task, (some, trials) in counts.items()
    ]
