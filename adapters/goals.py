"""Measures by a task's goal, in the entries of its privileged state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from robogauntlet.adapters.contract import FloatArray, Goal

AXES = "xyz"


def goal_distance(goal: Goal, value: FloatArray, target: FloatArray) -> FloatArray:
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
    missing: FloatArray = changed - offset
    if missing.shape[-1] == len(AXES):
        missing = missing[..., [AXES.index(axis) for axis in goal.axes]]
    return np.asarray(np.linalg.norm(missing, axis=-1))


def goal_mistakes(goal: Goal, state: Mapping[str, FloatArray]) -> Iterator[tuple[str, str, str]]:
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
