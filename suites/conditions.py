"""Conditions as text, wherever one is given: in suites, on the command line and in Python.

A condition is `noise@2`, and a combination `noise@2+table@3.5`, wherever one is shown or given.
"""

from __future__ import annotations

import re

from robogauntlet.suites.axes import AXES, axes_of
from robogauntlet.suites.episode import AND, AT, CLEAN, CONTROLS, Condition, Perturbation
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput

EXPECTED = "clean, AXIS or AXIS@SEVERITY[,SEVERITY], such as noise@2,4 or noise@2+table@3.5"
SMALLEST = 0.01
"""The smallest severity, and the unit in which they are kept."""
_OTHER_SIGN = re.compile(r"(?<=[a-z*])[:=](?=[0-9*?])")
_SEVERITY = re.compile(r"[0-9]{1,9}([.][0-9]{1,9})?")


def split_condition(text: str) -> tuple[str, str | None]:
    """Return the axis and what follows the sign `@`, unread; None without the sign.

    Raises:
        ValueError: The sign is another, as in `noise:2`; the message has the text to write.
    """
    if _OTHER_SIGN.search(text):
        raise ValueError(f"expected {_OTHER_SIGN.sub(AT, text)}{_got(text)}")
    axis, sign, severities = text.partition(AT)
    return axis, severities if sign else None


def read_severities(text: str) -> tuple[str, tuple[float, ...] | None]:
    """Return the axis and the severities that a text names, None for an axis alone. Names are not checked.

    A combination is an axis with the severity 1, see `Condition`.

    Raises:
        ValueError: The text after the sign is no list of severities, or an axis is named twice.
    """
    axis, listed = split_condition(text)
    if AND in text:
        parts = [read_severities(part) for part in text.split(AND)]
        given = [Perturbation(axis, severities[0]) for axis, severities in parts if severities and len(severities) == 1]
        if len(given) < len(parts) or not all(one.severity for one in given):
            raise ValueError(f"expected {EXPECTED}{_got(text)}")
        combined = Condition.of(*given)
        return combined.axis, (combined.severity,)
    if listed is None:
        return axis, None
    severities = listed.split(",")
    if not axis or not all(map(_SEVERITY.fullmatch, severities)):
        raise ValueError(f"expected {EXPECTED}{_got(text)}")
    return axis, tuple(in_hundredths(float(severity)) for severity in severities)


def in_hundredths(value: float) -> float:
    """Return a severity, or 0, as an integer if it is whole, so that equal severities are written alike.

    Raises:
        ValueError: It is below `SMALLEST`, or no multiple of it.
    """
    rounded = round(value, 2)
    if value and not rounded > 0:
        raise ValueError(f"expected a severity from {SMALLEST}, got {value:g}")
    if rounded != value:
        raise ValueError(f"expected a severity in hundredths, such as {rounded:g}, got {value:.9g}")
    return int(value) if value % 1 == 0 else value


def read_condition(text: str) -> Condition:
    """Return the one condition that a text names.

    This is `clean`, a control such as `again`, `AXIS@SEVERITY`, or a combination of these joined by `+`.

    Raises:
        BadInput: There is no such axis or severity, the axes do not combine, or the text names several conditions.
    """
    if text == CLEAN:
        return Condition()
    axis, severities = read_axis(text)
    if len(severities) != 1 and axis in AXES:
        raise BadInput(f"condition '{text}': expected one severity, such as {axis}@2, got {len(severities)}")
    condition = condition_of(axis, severities[0])
    for part in condition.perturbations or (Perturbation(axis, severities[0]),):
        if part.axis not in AXES:
            raise BadInput(f"condition '{text}': unknown axis '{part.axis}'{did_you_mean(part.axis, [CLEAN, *AXES])}")
        if not 0 < part.severity <= _levels(part.axis):
            lowest = 1 if AXES[part.axis].unchanged is None else SMALLEST
            raise BadInput(
                f"condition '{text}': expected a severity from {lowest} to {_levels(part.axis)}, got {part.severity:g}"
            )
    try:
        axes_of(condition)
    except ValueError as error:
        raise BadInput(f"condition '{text}': {error}") from None
    return condition


def condition_of(axis: str, severity: float) -> Condition:
    """Return the condition of an axis, or of a combination's spelling, at a severity, whole or not."""
    whole = float(severity).is_integer()
    return Condition(axis, int(severity)) if whole else Condition.of(Perturbation(axis, severity))


def read_axis(text: str) -> tuple[str, tuple[float, ...]]:
    """Return an axis and its severities: those that the text names, or all. An unknown axis has one.

    Raises:
        BadInput: The text names no severities after the sign, or an axis twice.
    """
    try:
        axis, severities = read_severities(text)
    except ValueError as error:
        raise BadInput(f"condition '{text}': {str(error).removesuffix(_got(text))}") from None
    return axis, tuple(range(1, _levels(axis) + 1)) if severities is None else severities


def condition_patterns(text: str) -> list[str]:
    """Return patterns of what `str(Condition)` gives: `noise@2,4` as `noise@2` and `noise@4`, `noise` as `noise@?`.

    Raises:
        BadInput: A combination is none, or the sign is another than `@`.
    """
    if AND in text:
        axis, severities = read_axis(text)
        return [str(condition_of(axis, severities[0]))]
    try:
        axis, listed = split_condition(text)
    except ValueError as error:
        raise BadInput(f"condition '{text}': {str(error).removesuffix(_got(text))}") from None
    if axis in CONTROLS:
        return [axis]
    if listed is None:
        return [f"{axis}@?"] if axis in AXES else [axis]
    return [f"{axis}@{severity}" for severity in listed.split(",")]


def _got(text: str) -> str:
    return f", got '{text}'"


def _levels(axis: str) -> int:
    return len(AXES[axis].levels) if axis in AXES else 1
