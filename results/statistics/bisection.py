"""Bisection over checkpoints: which one is the first that lost half of what the last one lost, with few episodes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robogauntlet.results.statistics.multiplicity import ALPHA

Play = Callable[[int, range], Sequence[float] | NDArray[np.float64]]
"""Plays a checkpoint on seeds: the outcome of each, 1 or 0, or NaN without a verdict."""
BATCH = 10
"""Seeds between two evaluations of the evidence."""
MOST_SEEDS = 1_000
"""Seeds after which a question stays open."""
BETS = 64
"""Stakes over which `log_betting_evidence` takes the mean."""


@dataclass(frozen=True, slots=True)
class Question:
    """Whether a checkpoint is worse than the first by at least half of the difference of the ends."""

    checkpoint: int
    """Of the last checkpoint it is asked whether it is worse at all."""
    is_worse: bool | None
    """None if the seeds did not decide it."""
    seeds: int
    """Seeds on which the outcomes were compared."""
    evidence: float
    """The e-value of the answer, at least (questions) / alpha; of an open question, the larger of both."""


class EndsDoNotDiffer(ValueError):
    """It was not shown that the last checkpoint is worse than the first."""

    def __init__(self, message: str, question: Question) -> None:
        super().__init__(message)
        self.question = question
        """The question about the ends, with its answer."""


@dataclass(frozen=True, slots=True)
class Bisection:
    """Where the checkpoints became worse."""

    last_good: int
    """A checkpoint that is not worse by half of the difference, or 0."""
    first_worse: int
    """A later one that is."""
    confidence: float
    """Probability with which both are so."""
    episodes: int
    """Episodes played, of all checkpoints."""
    questions: tuple[Question, ...]
    """In the order in which they were asked; the first is about the ends."""

    @property
    def is_found(self) -> bool:
        """Whether no checkpoint is left in between; else a question stayed open."""
        return self.first_worse == self.last_good + 1


def bisect_checkpoints(
    last: int, play: Play, *, alpha: float = ALPHA, batch: int = BATCH, most_seeds: int = MOST_SEEDS
) -> Bisection:
    """Find the first checkpoint that is worse than checkpoint 0 by at least half of the difference of the ends.

    With g, c and b the outcomes of the first, an inner and the last checkpoint on the same seed, the mean of

        (g - c) - (g - b) / 2 = (g + b) / 2 - c

    is 0 or more if the checkpoint lost half of the difference or more, and less than 0 otherwise. Each question bets
    on both signs (`log_betting_evidence`), after every batch of seeds, and is answered at an e-value of (questions) /
    alpha. Half of the difference is never estimated, so no error of an estimate enters. The first and the last
    checkpoint are played once per seed and serve all questions.

    There are 1 + ceil(log2(last)) questions at most. A wrong result needs a wrong answer, and the first wrong one is to
    a question that is asked if all before it are right: these are fixed before any episode. So each has its share of
    alpha, whatever its outcomes have in common with those of others, and all answers are right with a probability of at
    least 1 - alpha. Outcomes on different seeds have to be independent.

    If a later checkpoint recovers, there are several first ones that are worse after one that is not; this finds one.
    A checkpoint that lost almost exactly half cannot be decided: the result is then the range that is left.

    Args:
        last: Number of the last checkpoint, at least 1; the first is 0.
        play: Plays a checkpoint on seeds that it has not played yet; seeds begin at 0 and are those of all checkpoints.
        alpha: Largest probability of a wrong result.
        batch: Seeds between two evaluations of the evidence.
        most_seeds: Seeds after which a question stays open.

    Raises:
        EndsDoNotDiffer: `most_seeds` did not show that the last checkpoint is worse than the first.
        ValueError: No checkpoint beside the first, an alpha outside (0, 1), numbers of seeds below 1, or another number
            of outcomes than of seeds.
    """
    if last < 1 or batch < 1 or most_seeds < 1 or not 0 < alpha < 1:
        raise ValueError(
            "expected a last checkpoint, a batch and a number of seeds of at least 1 and an alpha between 0 and 1, got "
            f"{last}, {batch}, {most_seeds} and {alpha}"
        )
    needed = needed_evidence(last, alpha)
    played = _Played(play, needed, batch, most_seeds)
    ends = played.ask(last, {0: 1.0, last: -1.0})
    if not ends.is_worse:
        found = "not shown" if ends.is_worse is None else "shown not to be"
        raise EndsDoNotDiffer(
            f"expected checkpoint {last} to be worse than checkpoint 0; {ends.seeds:,} seeds: {found} "
            f"(e-value {ends.evidence:.3g}, needed {needed:.3g})",
            ends,
        )
    good, worse, questions = 0, last, [ends]
    while worse - good > 1:
        middle = (good + worse) // 2
        answer = played.ask(middle, {0: 0.5, last: 0.5, middle: -1.0})
        questions.append(answer)
        if answer.is_worse is None:
            break
        good, worse = (good, middle) if answer.is_worse else (middle, worse)
    return Bisection(good, worse, 1 - alpha, played.episodes, tuple(questions))


def needed_evidence(last: int, alpha: float = ALPHA) -> float:
    """The e-value that answers a question: the largest number of questions about checkpoints 0 to `last`, by alpha."""
    return (1 + math.ceil(math.log2(last))) / alpha


def log_betting_evidence(values: NDArray[np.float64]) -> float:
    """Natural logarithm of an e-value against a mean of at most 0 of independent values between -1 and 1.

    A stake l is bet on each value: the product of 1 + l x has an expectation of at most 1 if the mean of x is at most
    0, after any number of values (I. Waudby-Smith and A. Ramdas, "Estimating means of bounded random variables by
    betting", J. R. Statist. Soc. B 86 (2024) 1-27). Of `BETS` stakes between 0 and 1 the mean is taken, spread such
    that for values of -1 and 1 the probability of winning, (1 + l) / 2, is distributed as Beta(1/2, 1/2) above 1/2, as
    in `sequential.paired_evidence`.

    Args:
        values: Shape (n,). An n of 0 gives 0.
    """
    stakes = np.sin(np.pi * (np.arange(BETS) + 0.5) / (2 * BETS))
    kinds, counts = np.unique(values, return_counts=True)
    logarithms = np.log1p(np.outer(stakes, kinds)) @ counts
    return float(np.logaddexp.reduce(logarithms) - math.log(BETS))


class _Played:
    """The outcomes of all checkpoints, played as far as questions need them."""

    def __init__(self, play: Play, needed: float, batch: int, most_seeds: int) -> None:
        self._play, self._needed, self._batch, self._most = play, needed, batch, most_seeds
        self._outcomes: dict[int, NDArray[np.float64]] = {}

    @property
    def episodes(self) -> int:
        return sum(map(len, self._outcomes.values()))

    def ask(self, checkpoint: int, weights: Mapping[int, float]) -> Question:
        """Decide the sign of the mean of the weighted outcomes; above 0 the checkpoint is worse."""
        seeds, counted, either = 0, 0, 0.0
        while seeds < self._most:
            seeds = self._soonest(weights, seeds)
            values = np.sum([weight * self._first(one, seeds) for one, weight in weights.items()], axis=0)
            values = values[~np.isnan(values)]
            if len(values) == counted:
                continue
            counted = len(values)
            for sign in (1.0, -1.0):
                evidence = log_betting_evidence(sign * values)
                either = evidence if sign > 0 else max(either, evidence)
                if evidence >= math.log(self._needed):
                    return Question(checkpoint, sign > 0, seeds, _exponential(evidence))
        return Question(checkpoint, None, seeds, _exponential(either))

    def _soonest(self, weights: Mapping[int, float], seeds: int) -> int:
        """The next number of seeds at which the question could be decided, if all missing outcomes were for it.

        Evaluations before cannot decide, so that their seeds are played together.
        """
        while seeds < self._most:
            seeds = min(seeds + self._batch, self._most)
            for sign in (1.0, -1.0):
                values = np.zeros(seeds)
                for one, weight in weights.items():
                    known = self._outcomes.get(one, np.empty(0))[:seeds]
                    values[: len(known)] += sign * weight * known
                    values[len(known) :] += max(sign * weight, 0.0)
                if log_betting_evidence(values[~np.isnan(values)]) >= math.log(self._needed):
                    return seeds
        return seeds

    def _first(self, checkpoint: int, seeds: int) -> NDArray[np.float64]:
        """The outcomes on the first seeds; those that are missing are played."""
        known = self._outcomes.get(checkpoint, np.empty(0))
        if len(known) < seeds:
            new = np.asarray(self._play(checkpoint, range(len(known), seeds)), dtype=float)
            if new.shape != (seeds - len(known),):
                raise ValueError(f"expected {seeds - len(known)} outcomes of checkpoint {checkpoint}, got {new.shape}")
            known = self._outcomes[checkpoint] = np.concatenate([known, new])
        return known[:seeds]


def _exponential(logarithm: float) -> float:
    return math.exp(logarithm) if logarithm < math.log(np.finfo(float).max) else math.inf
