"""Where worker time went, as words."""

from __future__ import annotations

from collections.abc import Sequence

from results.profile import Profile
from results.report import text
from results.report.text import NOTHING, TextTable


def profile_table(profiles: Sequence[Profile]) -> TextTable:
    """The bound, what was beyond it, and the efficiency, per simulator."""
    parts = ("at median cost", "beyond", "rest", "waiting", "errors")
    header = ("simulator", "episodes", *parts, "together", "efficiency", "start-up")
    return TextTable(header, tuple(_line(row) for row in profiles), 1)


def _line(row: Profile) -> tuple[str, ...]:
    parts = (row.bound_s, row.slower_s, row.rest_s, row.wait_s, row.errors_s, row.measured_s)
    return (
        row.simulator or "all",
        text.count(row.episodes),
        *(text.seconds(part) if part >= 0 else f"-{text.seconds(-part)}" for part in parts),
        NOTHING if row.efficiency is None else f"{row.efficiency:.3f}",
        text.seconds(row.startup_s),
    )
