"""What is refused when experts are merged. Light: a recipe is checked without torch."""

from __future__ import annotations

from policies.contract import PolicyError


class MergeError(PolicyError):
    """These weights cannot be merged like this; the message says what was expected and what came."""


class ExpertsDiffer(MergeError):
    """The experts do not have the same weights: other names, shapes or types, or no finite numbers."""


class DifferentBases(MergeError):
    """The experts were not fine-tuned from one base, so that their task vectors cannot be added."""


class OutOfRange(MergeError):
    """An option is outside the values that make sense."""


def check_range(
    option: str, value: object, low: float, high: float, *, closed: str = "()", whole: bool = False
) -> None:
    """Refuse a number outside an interval.

    Args:
        option: What the number is, for the message.
        value: The number.
        low: Lower end.
        high: Upper end.
        closed: Which ends belong to the interval, as in mathematics: `()`, `[)`, `(]` or `[]`.
        whole: Whether it has to be an integer.

    Raises:
        OutOfRange: It is outside, or not a number.
    """
    kinds = (int,) if whole else (int, float)
    if isinstance(value, kinds) and not isinstance(value, bool):
        above = value >= low if closed[0] == "[" else value > low
        below = value <= high if closed[1] == "]" else value < high
        if above and below:
            return
    kind = "a whole number" if whole else "a number"
    raise OutOfRange(f"expected {option} to be {kind} in {closed[0]}{low:g}, {high:g}{closed[1]}, got {value!r}")
