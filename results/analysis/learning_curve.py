"""The success of a policy's checkpoints by step, and the best of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robogauntlet.results.record import Status
from robogauntlet.results.statistics.held_out import Count, HeldOutBest, held_out_best
from robogauntlet.results.statistics.rates import Estimate, wilson_interval
from robogauntlet.suites.episode import CLEAN

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("policy", "axis", "seed", "status")
"""Fields of the record that a learning curve needs."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """A checkpoint and its clean episodes."""

    name: str
    step: int
    even: Count
    """Successes and episodes with a verdict on even seeds."""
    odd: Count
    """Those on odd seeds."""
    errors: int

    @property
    def count(self) -> Count:
        """Successes and episodes with a verdict on all seeds."""
        return self.even[0] + self.odd[0], self.even[1] + self.odd[1]

    @property
    def estimate(self) -> Estimate | None:
        """Success with Wilson's interval; None without an episode that has a verdict."""
        successes, episodes = self.count
        return Estimate(successes / episodes, wilson_interval(successes, episodes)) if episodes else None


@dataclass(frozen=True, slots=True)
class LearningCurve:
    """The checkpoints of a training."""

    policy: str
    points: tuple[CurvePoint, ...]
    """By step."""
    best: HeldOutBest | None
    """The best of the points: chosen on even seeds, measured on odd ones."""


def curve_point(name: str, step: int, policy: str, rows: pd.DataFrame) -> CurvePoint:
    """The point of a checkpoint; `rows` are those of its run, with the columns `COLUMNS`."""
    own = rows[(rows["policy"] == policy) & (rows["axis"] == CLEAN)]
    is_error, is_even = own["status"] == str(Status.ERROR), own["seed"] % 2 == 0

    def count(half: pd.Series) -> Count:
        judged = own["status"][half & ~is_error]
        return int((judged == str(Status.SUCCESS)).sum()), len(judged)

    return CurvePoint(name, step, count(is_even), count(~is_even), int(is_error.sum()))


def learning_curve(policy: str, points: Iterable[CurvePoint]) -> LearningCurve:
    """Order the points by step and choose the best; of equal ones the earliest."""
    ordered = tuple(sorted(points, key=lambda point: (point.step, point.name)))
    best = held_out_best([point.even for point in ordered], [point.odd for point in ordered])
    return LearningCurve(policy, ordered, best)
