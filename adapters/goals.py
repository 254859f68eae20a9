"""The goal of a task in the entries of its privileged state, and measures by it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

AXES = "xyz"


@dataclass(frozen=True)
class Goal:
    """What a task's robot has to achieve, in entries of `privileged_state`.

    Progress and the kinds of failures are measured with it; success is the task's own predicate.
    """

    entry: str
    """Entry that has to change: `cube_position`, `hinge_angle`, or `tcp_position` if the tool itself has to arrive."""
    to: str = ""
    """Entry that it has to reach; if empty, `entry` has to change from its value at the start by `offset` or more."""
    offset: tuple[float, ...] = (0.0,)
    """From `to`, or from the value at the start (m, rad)."""
    axes: str = "xyz"
    """Coordinates that count in the distance from `to`."""
    tolerance: float = 0.0
    """Distance at which the goal is reached (m, rad)."""
    handle: str = ""
    """Entry with the place that the tool has to go to first; `entry` if empty, which is then a position."""
    grasped: bool = False
    """Whether the gripper has to hold it."""

    def __post_init__(self) -> None:
        """Raise ValueError for a value that cannot be measured; the message has its name."""
        if not self.entry:
            raise ValueError("entry: expected the name of an entry of the privileged state")
        if not self.axes or set(self.axes) - set("xyz") or len(set(self.axes)) != len(self.axes):
            raise ValueError(
                f"axes: expected letters out of 'xyz', each at most once, such as 'xy', found {self.axes!r}"
            )
        if len(self.offset) not in (1, 3) or not all(math.isfinite(number) for number in self.offset):
            raise ValueError(f"offset: expected 1 or 3 finite numbers, found {self.offset!r}")
        if not (math.isfinite(self.tolerance) and self.tolerance >= 0.0):
            raise ValueError(f"tolerance: expected a finite number, 0 or more, found {self.tolerance!r}")
        if not self.to and not any(self.offset):
            raise ValueError(f"offset: expected a change from the start, since there is no 'to', found {self.offset!r}")


def goal_distance(goal: Goal, value: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far a goal's entry is from where it has to be (m, rad), shape (...).

    Args:
        goal: The task's goal.
        value: Values of `goal.entry`, shape (..., n).
        target: Those of `goal.to`, or that of `goal.entry` at the start if there is none; broadcast to `value`.
    """
    offset, changed = np.asarray(goal.offset), value - target
    if not goal.to:
        way = float(np.linalg.norm(offset))
        return np.asarray(np.maximum(0.0, way - (changed * (offset / way)).sum(axis=-1)))
    missing: NDArray[np.float64] = changed - offset
    if missing.shape[-1] == len(AXES):
        missing = missing[..., [AXES.index(axis) for axis in goal.axes]]
    return np.asarray(np.linalg.norm(missing, axis=-1))


def goal_mistakes(goal: Goal, state: Mapping[str, NDArray[np.float64]]) -> Iterator[tuple[str, str, str]]:
    """Yield what of a goal does not fit a privileged state: the field, what was expected, and what was found."""
    named = {field: name for field in ("entry", "to", "handle") if (name := getattr(goal, field))}
    missing = {field: name for field, name in named.items() if name not in state}
    for field, name in missing.items():
        yield field, f"an entry of the privileged state, {', '.join(sorted(state))}", f"'{name}'"
    if missing:
        return
    shape = np.shape(state[goal.entry])
    if goal.to and np.shape(state[goal.to]) != shape:
        yield "to", f"'{goal.to}' to have the shape of '{goal.entry}', {shape}", str(np.shape(state[goal.to]))
    if len(goal.offset) != 1 and shape != (len(goal.offset),):
        yield "offset", f"1 number, or as many as '{goal.entry}' has, {shape}", str(len(goal.offset))
    if shape != (3,) and goal.axes != AXES:
        yield "axes", f"'{AXES}', since '{goal.entry}' is no position", repr(goal.axes)
    place = goal.handle or goal.entry
    if np.shape(state[place]) != (3,):
        yield "handle", f"a position, shape (3,), of '{place}'", str(np.shape(state[place]))
