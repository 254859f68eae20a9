"""Errors of merging. Light: a recipe is checked without torch."""

from __future__ import annotations

from robogauntlet.policies.contract import PolicyError


class MergeError(PolicyError):
    """Weights that cannot be merged in this way."""


class ExpertsDiffer(MergeError):
    """Experts of different weights: other names, shapes or types, or numbers that are not finite."""


class DifferentBases(MergeError):
    """Experts that were fine-tuned from different bases, whose task vectors cannot be added."""


class OutOfRange(MergeError):
    """An option out of its range."""


def check_range(
    option: str, value: object, low: float, high: float, *, closed: str = "()", whole: bool = False
) -> None:
    """Raise OutOfRange, which names `option`, unless `value` is a number in the interval.

    `closed` holds the brackets of the interval: `()`, `[)`, `(]` or `[]`. With `whole`, only integers are accepted.
    """
    kinds = (int,) if whole else (int, float)
    if isinstance(value, kinds) and not isinstance(value, bool):
        above = value >= low if closed[0] == "[" else value > low
        below = value <= high if closed[1] == "]" else value < high
        if above and below:
            return
    kind = "a whole number" if whole else "a number"
    raise OutOfRange(f"expected {option} to be {kind} in {closed[0]}{low:g}, {high:g}{closed[1]}, got {value!r}")
