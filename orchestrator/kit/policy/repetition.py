"""Findings about repeated episodes: state that is kept from one to the next, and determinism."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from robogauntlet.adapters.contract import FloatArray
from robogauntlet.orchestrator.kit.finding import Finding, Level
from robogauntlet.orchestrator.kit.policy.recording import Play

CLOSE = 1e-4
"""Differences of actions up to this are rounding (m, rad)."""
REMEDY = "write reset(self), which resets all state of an episode"


def repeated(first: Play, again: Play, play_afresh: Callable[[], FloatArray]) -> Iterator[Finding]:
    """Compare an episode with its repetition by the same policy, after another episode.

    Args:
        first: The episode, as the first one that the policy played.
        again: The same episode, after another one.
        play_afresh: Plays it in a new process and returns its actions, which is needed only if the two differ: if that
            repeats `first`, then `again` differs by what was kept.

    Raises:
        InvalidAnswer: The fresh policy raised, or its answer is not an action chunk.
    """
    gap = largest_difference(first.actions(), again.actions())
    if gap == 0:
        yield Finding("state", Level.OK, "the same episode after another one: the same actions, bit-identical")
        return
    numbers = {"largest_difference": gap}
    where = f"from query {first_difference(first, again) + 1} on, by up to {gap:.2g}"
    if gap <= CLOSE:
        text = f"the same episode after another one: actions differ by up to {gap:.1g}; rows will not be bit-identical"
        yield Finding("state", Level.NOTE, text, numbers)
        return
    unrepeatable = largest_difference(first.actions(), play_afresh())
    if unrepeatable <= CLOSE:
        text = f"the same episode after another one: other actions {where}, although a new process repeats the first"
        yield Finding("state", Level.FAILED, f"{text}: state leaks from episode to episode; {REMEDY}", numbers)
        return
    numbers["largest_difference_new_process"] = unrepeatable
    text = (
        f"the same episode in a new process: other actions, by up to {unrepeatable:.2g}; draw noise from a "
        "generator that each episode seeds again, else rows cannot be repeated and state that leaks is not seen"
    )
    yield Finding("determinism", Level.WARNING, text, numbers)


def largest_difference(one: FloatArray, other: FloatArray) -> float:
    """Return the largest difference of actions, shape (steps, numbers of an action), over the steps of both."""
    steps = min(len(one), len(other))
    return float(np.abs(one[:steps] - other[:steps]).max())


def first_difference(one: Play, other: Play) -> int:
    """Return the number of the first answer that differs, from 0."""
    pairs = zip(one.answers, other.answers, strict=False)
    differing = (number for number, (a, b) in enumerate(pairs) if not np.array_equal(a.chunk, b.chunk))
    return next(differing, min(len(one.answers), len(other.answers)))
