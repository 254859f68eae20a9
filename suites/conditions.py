"""Conditions as text, wherever one is given: in suites, on the command line and in Python.

A condition is shown as `noise@2`; `noise:2` says the same.
"""

from __future__ import annotations

import re

from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CLEAN, CONTROLS, Condition
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput

EXPECTED = "clean, AXIS or AXIS@SEVERITY[,SEVERITY], such as noise@2,4"
_PARTS = re.compile(r"(?P<axis>[^@:]*)(?P<sign>[@:]?)(?P<severities>.*)", re.DOTALL)
_SEVERITY = re.compile(r"[0-9]{1,9}")


def split_condition(text: str) -> tuple[str, str | None]:
    """Return the axis and what follows its sign `@` or `:`, unread; None without a sign."""
    axis, sign, severities = _PARTS.fullmatch(text).groups()  # type: ignore[union-attr] # every text matches
    return axis, severities if sign else None


def read_severities(text: str) -> tuple[str, tuple[int, ...] | None]:
    """Return the axis and the severities that a text names, None for an axis alone. Names are not checked.

    Raises:
        ValueError: The text after the sign is no list of severities.
    """
    axis, listed = split_condition(text)
    if listed is None:
        return axis, None
    severities = listed.split(",")
    if not axis or not all(map(_SEVERITY.fullmatch, severities)):
        raise ValueError(f"expected {EXPECTED}, got '{text}'")
    return axis, tuple(map(int, severities))


def read_condition(text: str) -> Condition:
    """Return the one condition that a text names: `clean`, a control such as `again`, or `AXIS@SEVERITY`.

    Raises:
        BadInput: There is no such axis or severity, or the text names several.
    """
    if text == CLEAN:
        return Condition()
    axis, severities = read_axis(text)
    if axis not in AXES:
        raise BadInput(f"condition '{text}': unknown axis '{axis}'{did_you_mean(axis, [CLEAN, *AXES])}")
    if len(severities) != 1:
        raise BadInput(f"condition '{text}': expected one severity, such as {axis}@2, got {len(severities)}")
    if not 1 <= severities[0] <= _levels(axis):
        raise BadInput(f"condition '{text}': expected a severity from 1 to {_levels(axis)}, got {severities[0]}")
    return Condition(axis, severities[0])


def read_axis(text: str) -> tuple[str, tuple[int, ...]]:
    """Return an axis and its severities: those that the text names, or all. An unknown axis has one.

    Raises:
        BadInput: The text names no severities after the sign.
    """
    try:
        axis, severities = read_severities(text)
    except ValueError:
        raise BadInput(f"condition '{text}': expected {EXPECTED}") from None
    return axis, tuple(range(1, _levels(axis) + 1)) if severities is None else severities


def condition_patterns(text: str) -> list[str]:
    """Return patterns of what `str(Condition)` gives: `noise:2,4` as `noise@2` and `noise@4`, `noise` as `noise@*`."""
    axis, severities = split_condition(text)
    if axis in CONTROLS:
        return [axis]
    if severities is None:
        return [f"{axis}@*"] if axis in AXES else [axis]
    return [f"{axis}@{severity}" for severity in severities.split(",")]


def _levels(axis: str) -> int:
    return len(AXES[axis].levels) if axis in AXES else 1
