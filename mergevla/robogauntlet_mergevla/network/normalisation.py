"""Normalisation of actions and proprioception: the training data's 1 % and 99 % quantiles become -1 and +1.

As in the paper, each number has its own range; in addition, very small ranges of actions are widened first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import model_serializer, model_validator
from pydantic.dataclasses import dataclass

from robogauntlet.adapters.contract import ACTION_DIM, PROPRIOCEPTION_DIM, FloatArray
from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.stored import STRICT, Stored

SMALLEST_RANGE = 1e-6
"""A number that varies by less (m, rad) is constant: it is normalised to 0."""

LEAST_SPAN = (*(0.01,) * 3, *(0.1,) * 3, 0.0)
"""Smallest range of each number of an action (m, rad, gripper); smaller ones are widened. In a task without rotations,
quantiles would scale the oracle's corrections of a hundredth of a radian up to the size of whole motions, which would
then dominate the loss."""


class StatisticsError(PolicyError):
    """Invalid or missing normalisation statistics."""


@dataclass(frozen=True, config=STRICT)
class Quantiles:
    """Range of each number of a vector."""

    q01: tuple[float, ...]
    q99: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.q01) != len(self.q99):
            raise StatisticsError(f"expected as many q01 as q99, got {len(self.q01)} and {len(self.q99)}")
        for low, high in zip(self.q01, self.q99, strict=True):
            if not (math.isfinite(low) and math.isfinite(high) and low <= high):
                raise StatisticsError(f"expected finite quantiles with q01 <= q99, got {low} and {high}")

    @classmethod
    def of(cls, samples: ArrayLike) -> Quantiles:
        """Return the quantiles of samples (n, dim). Raises StatisticsError without samples, or if one is not finite."""
        values = np.asarray(samples, dtype=np.float64)
        if values.ndim != 2 or len(values) == 0:
            raise StatisticsError(f"expected samples of shape (n, dim) with n >= 1, got {values.shape}")
        low, high = np.quantile(values, [0.01, 0.99], axis=0)
        return cls(tuple(low.tolist()), tuple(high.tolist()))

    def widened(self, least: Sequence[float]) -> Quantiles:
        """Return ranges of at least these spans, around the same centres; constant numbers stay constant."""
        low, span = self._low_and_span()
        missing = np.where(span > SMALLEST_RANGE, np.maximum(np.array(least) - span, 0.0), 0.0)
        return Quantiles(tuple((low - missing / 2).tolist()), tuple((low + span + missing / 2).tolist()))

    @classmethod
    def spanning(cls, ranges: Sequence[Quantiles]) -> Quantiles:
        """Return the smallest ranges that contain the ranges of the same numbers."""
        low = np.min([one.q01 for one in ranges], axis=0)
        return cls(tuple(low.tolist()), tuple(np.max([one.q99 for one in ranges], axis=0).tolist()))

    def normalise(self, values: ArrayLike) -> FloatArray:
        """Map q01 .. q99 to -1 .. +1 and clip to it, last axis by number."""
        low, span = self._low_and_span()
        varies = span > SMALLEST_RANGE
        scaled = 2.0 * (np.asarray(values, dtype=np.float64) - low) / np.where(varies, span, 1.0) - 1.0
        return np.where(varies, np.clip(scaled, -1.0, 1.0), 0.0)

    def restore(self, values: ArrayLike) -> FloatArray:
        """Map -1 .. +1 back to q01 .. q99, last axis by number, without clipping."""
        low, span = self._low_and_span()
        varies = span > SMALLEST_RANGE
        unit = (np.asarray(values, dtype=np.float64) + 1.0) / 2.0
        return low + np.where(varies, unit, 0.5) * span

    def _low_and_span(self) -> tuple[FloatArray, FloatArray]:
        low, high = np.array(self.q01), np.array(self.q99)
        return low, high - low


def padded(values: ArrayLike, numbers: int) -> NDArray[Any]:
    """Return values (..., n) with zeros after them, shape (..., `numbers`): what a task does not have."""
    given = np.asarray(values)
    return np.pad(given, [(0, 0)] * (given.ndim - 1) + [(0, numbers - given.shape[-1])])


@dataclass(frozen=True, config=STRICT)
class Statistics(Stored):
    """Statistics of one task's training data, by which proprioception and actions are normalised."""

    what: ClassVar = "normalisation statistics"
    refusal: ClassVar = StatisticsError

    action: Quantiles
    """Ranges of the numbers of an action (m, rad, gripper), see `robogauntlet.adapters.contract`."""
    proprioception: Quantiles
    """Ranges of the numbers of proprioception (m, rad, m)."""

    def __post_init__(self) -> None:
        numbers, seen = len(self.action.q01), len(self.proprioception.q01)
        tools = {ACTION_DIM * arms: PROPRIOCEPTION_DIM * arms for arms in (1, 2)}
        if numbers != seen and numbers in tools and seen != tools[numbers]:
            raise StatisticsError(f"expected proprioception statistics of {tools[numbers]} numbers, got {seen}")
        if numbers != seen and numbers not in tools:
            raise StatisticsError(f"expected action statistics of {ACTION_DIM} numbers, got {numbers}")

    @property
    def of_joints(self) -> bool:
        """Whether the numbers are those of joints, as many in proprioception as in an action."""
        return len(self.action.q01) == len(self.proprioception.q01)

    @classmethod
    def of(cls, actions: ArrayLike, proprioceptions: ArrayLike) -> Statistics:
        """Return the statistics of actions and proprioceptions, (n, numbers) each.

        Raises StatisticsError for other shapes, no samples, or samples that are not finite.
        """
        return cls(Quantiles.of(actions), Quantiles.of(proprioceptions)).widened()

    def widened(self) -> Statistics:
        """Return the statistics with the least spans of a tool's motion; the targets of joints range over radians."""
        if self.of_joints:
            return self
        least = LEAST_SPAN * (len(self.action.q01) // ACTION_DIM)
        return replace(self, action=self.action.widened(least))

    def normalise_actions(self, actions: ArrayLike) -> FloatArray:
        """Map actions (..., numbers) to [-1, 1]; grippers are only clipped."""
        given = np.asarray(actions, dtype=np.float64)
        return self._with_gripper(self.action.normalise(given), given)

    def restore_actions(self, normalised: ArrayLike) -> FloatArray:
        """The inverse of `normalise_actions` within its range, shape (..., numbers)."""
        given = np.asarray(normalised, dtype=np.float64)
        return self._with_gripper(self.action.restore(given), given)

    def normalise_proprioception(self, proprioception: ArrayLike) -> FloatArray:
        """Map proprioception (..., numbers) to [-1, 1]."""
        return self.proprioception.normalise(proprioception)

    def _with_gripper(self, actions: FloatArray, given: FloatArray) -> FloatArray:
        """Take the grippers as given: they are -1 .. +1 already, with only two values as a rule."""
        of_arm = len(self.action.q01) if self.of_joints else ACTION_DIM
        grippers = slice(of_arm - 1, None, of_arm)
        actions[..., grippers] = np.clip(given[..., grippers], -1.0, 1.0)
        return actions


_action, _proprioception = attrgetter("action"), attrgetter("proprioception")


@dataclass(frozen=True, config=STRICT)
class TaskStatistics(Stored):
    """Statistics by task: the same number may range over centimetres in one task and over decimetres in another.

    Statistics of a single task are used for every task, so that an expert can be evaluated on tasks it was not trained
    on. In a network with more numbers than a task has, the task has the first, and the others are zeros (`padded`).
    """

    what: ClassVar = "normalisation statistics by task"
    refusal: ClassVar = StatisticsError

    by_task: Mapping[str, Statistics]
    """Task (`simulator/task`) to its statistics."""

    def __post_init__(self) -> None:
        if not self.by_task:
            raise StatisticsError("expected normalisation statistics of one task at least, got none")

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks, in their order."""
        return tuple(self.by_task)

    @property
    def action_dims(self) -> frozenset[int]:
        """The sizes of the tasks' actions."""
        return frozenset(len(one.action.q01) for one in self.by_task.values())

    def of(self, task: str) -> Statistics:
        """Return the statistics for a task. Raises StatisticsError if there are several tasks', but not this one's."""
        if task in self.by_task:
            return self.by_task[task]
        if len(self.by_task) > 1:
            raise StatisticsError(f"expected one of the trained tasks {', '.join(self.by_task)}, got '{task}'")
        return next(iter(self.by_task.values()))

    def together(self, name: str) -> TaskStatistics:
        """Return one set of statistics for all tasks, under that name: the smallest ranges that contain all of theirs.

        Quantiles of all frames together would cut off motions that one task of many has. Raises StatisticsError for
        tasks with actions of several sizes.
        """
        if len({(len(one.action.q01), one.of_joints) for one in self.by_task.values()}) > 1:
            sizes = " and ".join(map(str, sorted(self.action_dims)))
            raise StatisticsError(
                f"expected actions of the same numbers in the tasks of expert '{name}', got {sizes}; "
                "train an expert of each"
            )
        every = self.by_task.values()
        action = Quantiles.spanning([one.action for one in every])
        joined = Statistics(action, Quantiles.spanning([one.proprioception for one in every]))
        return TaskStatistics({name: joined.widened()})

    def is_used(self, tasks: Sequence[str], numbers: int) -> NDArray[np.bool_]:
        """Return which numbers of a network's action each of b tasks has, shape (b, numbers)."""
        return np.array([np.arange(numbers) < len(self.of(task).action.q01) for task in tasks])

    def normalise_actions(self, tasks: Sequence[str], actions: ArrayLike) -> FloatArray:
        """Map actions (b, ..., numbers) of b tasks to [-1, 1]."""
        return self._each(tasks, actions, Statistics.normalise_actions, _action)

    def restore_actions(self, tasks: Sequence[str], normalised: ArrayLike) -> FloatArray:
        """The inverse of `normalise_actions` within its range, shape (b, ..., numbers)."""
        return self._each(tasks, normalised, Statistics.restore_actions, _action)

    def normalise_proprioception(self, tasks: Sequence[str], proprioception: ArrayLike) -> FloatArray:
        """Map proprioception (b, numbers) of b tasks to [-1, 1]."""
        return self._each(tasks, proprioception, Statistics.normalise_proprioception, _proprioception)

    def _each(
        self,
        tasks: Sequence[str],
        values: ArrayLike,
        change: Callable[[Statistics, ArrayLike], FloatArray],
        ranges: Callable[[Statistics], Quantiles],
    ) -> FloatArray:
        given = np.asarray(values, dtype=np.float64)
        changed = np.zeros_like(given)
        for task in set(tasks):
            rows = [row for row, name in enumerate(tasks) if name == task]
            statistics = self.of(task)
            used = slice(len(ranges(statistics).q01))
            changed[rows, ..., used] = change(statistics, given[rows][..., used])
        return changed

    @model_validator(mode="before")
    @classmethod
    def _read(cls, plain: Any) -> Any:
        """Accept the mapping itself, as it is in JSON."""
        return {"by_task": plain} if isinstance(plain, Mapping) else plain

    @model_serializer
    def _written(self) -> Mapping[str, Statistics]:
        return self.by_task
