"""Search for the smallest disturbance that breaks a policy, and its confirmation on fresh seeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from robogauntlet.results.statistics.boundary import Boundary, BoundaryEstimate, Trials, excess
from robogauntlet.suites.episode import FIRST_TRAINING_SEED

LARGEST = 5.0
"""The largest severity of an axis."""
FIRST_CONFIRMATION_SEED = 10_000
"""Seeds of the search lie below, those of the confirmation from here on, if each seed has a start of its own."""
LEAST_STATES = 40
"""Start states of the smallest search on a task whose seeds choose among some."""
MOST_EPISODES = 50_000
"""Largest budget, with which the seeds of the search stay below those of the confirmation."""
SEARCHED = 0.6
"""Share of the budget for the search; the rest confirms."""
LEAST_TRIALS = 12
"""Episodes of each axis, and of the clean condition, in the smallest search."""
LEAST_COMBINED = 24
"""Episodes of combinations in the smallest search."""
ROUNDS = 6
"""Rounds in which the axes alone are played."""
RUNG_ROUNDS = 2
"""Rounds after which the worse half of the directions is left out."""
LEAST_RUNG = 10
"""Episodes of a direction before it can be left out."""
MOST_DIRECTIONS = 16
FINALISTS = 2
SMALLEST_PART = 0.3
"""Axes with a smaller part than this of the largest one are left out of the direction of steepest descent."""
LEAST_CLEAN = 0.2
"""Clean rate below which half of it cannot be told from chance."""
BEYOND = 1.5
"""Multiple of the largest severity that stands for the boundary of an axis that does not break the policy."""

Point = tuple[tuple[str, float], ...]
"""Axes with their severities, by name; clean without any."""
CLEAN_POINT: Point = ()
Answer = Mapping[Point, Trials]


@dataclass(frozen=True, slots=True)
class SearchSpace:
    """What may be played."""

    axes: tuple[str, ...]
    whole: Collection[str] = ()
    """Those that have whole severities only."""
    combine: Callable[[Collection[str]], bool] = lambda names: True
    """Whether axes combine."""
    start_states: int | None = None
    """Start states among which seeds choose, of which the search never plays one twice; None without a limit."""


@dataclass(frozen=True, slots=True)
class Round:
    """Episodes to play: every point from each of the seeds."""

    stage: str
    points: tuple[Point, ...]
    """The clean one first."""
    seeds: range

    @property
    def episodes(self) -> int:
        """Their number."""
        return len(self.points) * len(self.seeds)


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A direction in the space of severities, its boundary, and the point on it that was confirmed or not."""

    direction: tuple[tuple[str, float], ...]
    """Axes with their parts, of Euclidean norm 1."""
    boundary: Boundary
    """In units of the norm."""
    searched: int
    """Episodes of the search in this direction."""
    point: Point
    """What the confirmation played."""
    breaks: bool
    """Whether the search found that success at the point is below the share of the clean rate, or that it is not."""
    is_proposed: bool
    """Whether its confirmation is likely, see `BoundaryEstimate.to_confirm`; if not, the episodes are too few, and the
    point is the largest severity."""
    found: Trials
    """Success at the point on the seeds of the confirmation."""
    clean: Trials
    """Clean success on the same seeds."""
    is_confirmed: bool
    """Whether the 95 % interval of success minus the share of clean success is on the side that the search found."""

    @property
    def norm(self) -> float:
        """Euclidean norm of the point's severities."""
        return norm_of(self.point)


@dataclass(frozen=True, slots=True)
class WorstCases:
    """What a search found."""

    clean_searched: Trials
    """Clean success on the seeds of the search."""
    clean: Trials
    """Clean success on the seeds of the confirmation."""
    axes: tuple[Disturbance, ...] = ()
    """Each axis alone, in the order given; none if the clean rate was too low for a search."""
    combined: Disturbance | None = None
    """The smallest combination that breaks the policy."""
    directions: int = 0
    """Directions of combinations that were searched."""
    episodes: int = 0


def norm_of(point: Point) -> float:
    """Euclidean norm of the severities."""
    return math.hypot(*(severity for _, severity in point))


def least_budget(axes: int) -> int:
    """Episodes of the smallest search with this number of axes, confirmation included."""
    return math.ceil((LEAST_TRIALS * (axes + 1) + (LEAST_COMBINED if axes > 1 else 0)) / SEARCHED)


def search_worst_cases(
    space: SearchSpace, budget: int, *, below: float = 0.5, seed: int = 0
) -> Generator[Round, Answer, WorstCases]:
    """Search for the smallest disturbance that breaks a policy: success below a share of its clean rate.

    The generator yields rounds of episodes and is sent the outcome of each point. What it asks depends on its arguments
    and the answers alone, so that an interrupted search is continued by giving the same answers again.

    1. Each axis alone: `BoundaryEstimate`.
    2. Combinations: directions whose parts are proportional to 1 / boundary of the axes, which is the shortest way out
       if disturbances add up, for all axes, for pairs and for three; and random ones. Each is searched as an axis is,
       and after every rung the worse half is left out (successive halving: Z. Karnin, T. Koren and O. Somekh, "Almost
       optimal exploration in multi-armed bandits", ICML 2013), until `FINALISTS` are left.
    3. Confirmation on seeds that the search did not see: every axis and the smallest combination, each at the smallest
       severity that is likely to be confirmed, or, where none is with so few episodes, at the largest; half of these
       episodes are for the smallest ones alone.

    Of limited start states three fifths are for the search. Where they end before the budget, less of it is played.

    Args:
        space: The axes, at least one, and `LEAST_STATES` start states or more.
        budget: Episodes in all, clean ones included.
        below: The share of the clean rate.
        seed: Draws the random directions.

    Raises:
        ValueError: The budget is smaller than `least_budget` or larger than `MOST_EPISODES`.
    """
    least = least_budget(len(space.axes))
    if not least <= budget <= MOST_EPISODES:
        raise ValueError(f"expected a budget from {least} to {MOST_EPISODES} episodes, got {budget}")
    return (yield from _Search(space, budget, below, seed).run())


class _Direction:
    """A direction, and what is known of the boundary along it."""

    def __init__(self, space: SearchSpace, parts: Mapping[str, float], below: float) -> None:
        length = math.hypot(*parts.values())
        self.parts = tuple((axis, part / length) for axis, part in sorted(parts.items()))
        self._whole = {axis for axis, _ in self.parts if axis in space.whole}
        largest = LARGEST / max(part for _, part in self.parts)
        self.estimate = BoundaryEstimate(largest, below=below, whole=len(self.parts) == 1 and bool(self._whole))
        self.largest = self.point(largest)

    def point(self, distance: float) -> Point:
        """The point at this distance from clean, its severities rounded to what axes have."""
        rounded = [
            (axis, float(round(distance * part)) if axis in self._whole else round(distance * part, 2))
            for axis, part in self.parts
        ]
        return tuple((axis, min(severity, LARGEST)) for axis, severity in rounded if severity > 0)

    def weight(self) -> float:
        """The inverse of the boundary."""
        return 1 / (self.estimate.boundary().value or BEYOND * LARGEST)


class _Search:
    def __init__(self, space: SearchSpace, budget: int, below: float, seed: int) -> None:
        self._space, self._budget, self._below = space, budget, below
        self._random = np.random.default_rng(seed)
        self._used = self._seed = 0
        states = space.start_states
        self._confirming = range(FIRST_CONFIRMATION_SEED, FIRST_TRAINING_SEED)
        if states is not None:
            self._confirming = range(int(SEARCHED * states), states)
        self._clean = Trials()
        self._alone = [_Direction(space, {axis: 1.0}, below) for axis in space.axes]
        self._combined: list[_Direction] = []

    def run(self) -> Generator[Round, Answer, WorstCases]:
        searched, count = int(SEARCHED * self._budget), len(self._alone)
        alone = searched if count == 1 else max(searched // 2, LEAST_TRIALS * (count + 1))
        end = self._confirming.start // (1 if count == 1 or self._space.start_states is None else 2)
        yield from self._rounds("axes alone", self._alone, alone, ROUNDS, math.ceil(3 / count), end)
        if self._hopeless():
            return WorstCases(self._clean, Trials(), episodes=self._used)
        finalists: list[_Direction] = []
        if count > 1:
            finalists = yield from self._halve(searched - self._used)
        return (yield from self._confirm(finalists))

    def _hopeless(self) -> bool:
        clean = self._clean
        return clean.trials > 0 and clean.successes < LEAST_CLEAN * clean.trials

    def _rounds(
        self, stage: str, directions: Sequence[_Direction], budget: int, rounds: int, points: int, end: int
    ) -> Generator[Round, Answer, None]:
        """Play directions, and clean, for as many episodes as the budget allows on seeds before `end`."""
        left = budget
        for remaining in range(rounds, 0, -1):
            asked = {id(one): one.estimate.ask(points) for one in directions}
            played = [one.point(t) for one in directions for t in asked[id(one)]]
            listed = tuple(dict.fromkeys([CLEAN_POINT, *filter(None, played)]))
            seeds = min(left // len(listed), end - self._seed) // remaining
            if seeds < 1:
                continue
            answer = yield self._round(stage, listed, seeds)
            left -= seeds * len(listed)
            self._clean += answer[CLEAN_POINT]
            for one in [*self._alone, *self._combined]:
                one.estimate.tell_clean(self._clean)
            for one in directions:
                for t in asked[id(one)]:
                    if point := one.point(t):
                        one.estimate.tell(t, answer[point])
            if self._clean.trials >= LEAST_TRIALS and self._hopeless():
                return

    def _round(self, stage: str, points: tuple[Point, ...], seeds: int) -> Round:
        found = Round(stage, points, range(self._seed, self._seed + seeds))
        self._seed += seeds
        self._used += found.episodes
        return found

    def _halve(self, budget: int) -> Generator[Round, Answer, list[_Direction]]:
        """Search combinations, and return those that are left."""
        count, seeds = MOST_DIRECTIONS, self._confirming.start - self._seed
        while count > FINALISTS and min(budget / count, seeds) < LEAST_RUNG * math.log2(2 * count / FINALISTS):
            count //= 2
        self._combined = left = self._directions(count)
        for one in left:
            one.estimate.tell_clean(self._clean)
        rungs = max(1, math.ceil(math.log2(max(len(left), 1) / FINALISTS)) + 1) if left else 0
        end = self._used + budget
        for rung in range(rungs, 0, -1):
            share = (end - self._used) // rung
            last = self._seed + (self._confirming.start - self._seed) // rung
            yield from self._rounds("combined", left, share, RUNG_ROUNDS, max(1, round(4 / len(left))), last)
            if rung > 1:
                left = sorted(left, key=lambda one: one.estimate.median)[: max(FINALISTS, math.ceil(len(left) / 2))]
        return left

    def _directions(self, count: int) -> list[_Direction]:
        """Directions of two axes and more, at most `count`."""
        weights = {one.parts[0][0]: one.weight() for one in self._alone}
        names = sorted(weights, key=lambda name: -weights[name])
        chosen: list[tuple[str, ...]] = []
        if (steepest := self._compatible(names, weights)) and len(steepest) > 1:
            chosen.append(steepest)
        allowed = [pair for pair in combinations(names, 2) if self._space.combine(pair)]
        allowed.sort(key=lambda pair: -math.hypot(*(weights[name] for name in pair)))
        three = self._compatible(names, weights, most=3)
        chosen += [*allowed[:1], *([three] if len(three) == 3 else []), *allowed[1 : count // 2]]
        parts = [{name: weights[name] for name in some} for some in dict.fromkeys(chosen)][: max(1, 3 * count // 4)]
        for _ in range(10 * count):
            if len(parts) >= count or not allowed:
                break
            some: tuple[str, ...] = allowed[int(self._random.integers(len(allowed)))]
            more = [name for name in names if name not in some and self._space.combine([*some, name])]
            if more and self._random.random() < 1 / 3:
                some = (*some, more[int(self._random.integers(len(more)))])
            parts.append({name: weights[name] * math.exp(self._random.normal() * 0.7) for name in some})
        return [_Direction(self._space, one, self._below) for one in parts]

    def _compatible(self, names: Sequence[str], weights: Mapping[str, float], most: int = 99) -> tuple[str, ...]:
        """The weakest points that combine with each other."""
        found: list[str] = []
        for name in names:
            strong = weights[name] >= SMALLEST_PART * weights[names[0]]
            if strong and len(found) < most and self._space.combine([*found, name]):
                found.append(name)
        return tuple(found)

    def _confirm(self, finalists: Sequence[_Direction]) -> Generator[Round, Answer, WorstCases]:
        """Play what was found on fresh seeds."""
        left, fresh = self._budget - self._used, len(self._confirming)
        broad = min(left // 2 // (len(self._alone) + 1 + bool(finalists)), fresh // 2)
        deep = broad + (left - broad * (len(self._alone) + 1 + bool(finalists))) // (2 + bool(finalists))
        deep = min(deep, fresh)
        combined = min(
            (claim for one in finalists if len((claim := _Claim(one, deep)).point) > 1 and claim.breaks),
            key=lambda claim: claim.order,
            default=None,
        )
        deeply = min((_Claim(one, deep) for one in self._alone), key=lambda claim: claim.order)
        claims = [deeply if one is deeply.direction else _Claim(one, broad) for one in self._alone]
        wanted = [*claims, *([combined] if combined else [])]
        self._seed, answers = self._confirming.start, []
        listed = tuple(dict.fromkeys([CLEAN_POINT, *(claim.point for claim in wanted)]))
        focus = tuple(dict.fromkeys([CLEAN_POINT, deeply.point, *([combined.point] if combined else [])]))
        if len(listed) > len(focus):
            seeds = min(left // 2 // len(listed), fresh // 2)
            answers.append((yield self._round("confirmation", listed, seeds)))
        seeds = min((self._budget - self._used) // len(focus), self._confirming.stop - self._seed)
        answers.append((yield self._round("confirmation", focus, seeds)))
        found = [claim.concluded(answers, self._below) for claim in wanted]
        return WorstCases(
            self._clean,
            sum((answer[CLEAN_POINT] for answer in answers), Trials()),
            tuple(found[: len(claims)]),
            found[-1] if combined else None,
            len(self._combined),
            self._used,
        )


class _Claim:
    """What the search claims of a direction: that a point on it breaks the policy, or that none does."""

    def __init__(self, direction: _Direction, trials: int) -> None:
        self.direction, self.boundary = direction, direction.estimate.boundary()
        self.breaks = self.boundary.value is not None
        distance = direction.estimate.to_confirm(trials) if self.breaks else None
        self.is_proposed = distance is not None or not self.breaks
        self.point = direction.largest if distance is None else direction.point(distance)
        self.order = (not self.breaks, distance is None, norm_of(self.point), direction.estimate.median)

    def concluded(self, answers: Sequence[Answer], below: float) -> Disturbance:
        """The claim with its confirmation."""
        both = [(answer[self.point], answer[CLEAN_POINT]) for answer in answers if self.point in answer]
        found, clean = (sum(side, Trials()) for side in zip(*both, strict=True))
        low, high = excess(found, clean, below)
        confirmed = high < 0 if self.breaks else low > 0
        estimate = self.direction.estimate
        parts = self.direction.parts
        claim = parts, self.boundary, estimate.trials, self.point, self.breaks, self.is_proposed
        return Disturbance(*claim, found, clean, confirmed)
