"""Durations as text."""

from __future__ import annotations


def format_duration(seconds: float, *, brief: bool = False) -> str:
    """A duration in whole seconds: `45 s`, `3 min 20 s`, `2 h 5 min`.

    Args:
        seconds: The duration; a negative one counts as 0.
        brief: Omit seconds above a minute, for displays that are updated often: `3 min`, `2 h 5 min`, `3 days`.
    """
    whole = round(max(seconds, 0.0))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min" if brief else f"{whole // 60} min {whole % 60} s"
    if brief and whole >= 2 * 86400:
        return f"{whole // 86400:,} days"
    return f"{whole // 3600:,} h {whole % 3600 // 60} min"


def format_range(low: float, high: float) -> str:
    """An estimated duration in the unit of its end, without what is smaller: `20 to 50 s`, `3 to 8 min`, `1 to 3 h`.

    Args:
        low: The shortest that is expected (s).
        high: The longest (s).
    """
    size, unit = next(
        (size, unit) for size, unit in ((3600, "h"), (60, "min"), (1, "s")) if high >= 1.5 * size or size == 1
    )
    first, last = round(low / size), max(round(high / size), 1)
    return f"{last} {unit}" if first == last else f"{first} to {last} {unit}" if first else f"at most {last} {unit}"
