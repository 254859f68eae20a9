"""Policies against each other under perturbations as words: heat maps, what merging costs, and which gave way first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from results.report import text
from results.report.merging import points, share
from results.report.robustness import judged, over_all, rate, short_title
from results.report.text import NOTHING, TextTable
from results.robustness import PolicyCurve, Robustness
from results.shift import Interaction, RouterRow, Shift, TaxRow, broke_first
from results.statistics.rates import Estimate, Interval
from suites.axes import AXES

REACH = 0.5
"""Half the range of a forest plot: a difference of rates."""


@dataclass(frozen=True, slots=True)
class HeatCell:
    """One policy at one level in one simulator."""

    rate: Estimate
    episodes: int


@dataclass(frozen=True, slots=True)
class HeatRow:
    """One level of one axis."""

    axis: str
    severity: int
    cells: tuple[HeatCell | None, ...]
    """One per column; None where nothing counts."""


@dataclass(frozen=True, slots=True)
class HeatMap:
    """One policy's success, levels by simulators."""

    policy: str
    columns: tuple[str, ...]
    """Simulators, then `all` if there are several."""
    rows: tuple[HeatRow, ...]


def heat_maps(robustness: Robustness) -> tuple[HeatMap, ...]:
    """A heat map per policy, the clean condition first."""
    policies = dict.fromkeys(curve.policy for curve in robustness.curves)
    return tuple(_heat_map(robustness, policy) for policy in policies)


def beside(robustness: Robustness, *, floors: bool) -> tuple[tuple[HeatMap, ...], ...]:
    """The heat maps in groups that share their rows, so that a group can be drawn as one.

    Args:
        robustness: Of the run.
        floors: Those of the floors, else those of all other policies.
    """
    groups: dict[tuple[tuple[str, int], ...], list[HeatMap]] = {}
    for found in heat_maps(robustness):
        if (found.policy in robustness.floors) is floors:
            groups.setdefault(tuple((row.axis, row.severity) for row in found.rows), []).append(found)
    return tuple(map(tuple, groups.values()))


def _heat_map(robustness: Robustness, policy: str) -> HeatMap:
    own = [curve for curve in robustness.curves if curve.policy == policy]
    places = sorted({curve.simulator for curve in own}, key=lambda name: (name is None, name or ""))
    rows: list[HeatRow] = []
    for axis in robustness.axes:
        here = {curve.simulator: curve for curve in own if curve.axis == axis}
        for level in sorted({int(level) for curve in here.values() for level in curve.curve.levels}):
            if level or not rows:
                rows.append(HeatRow(axis, level, tuple(_heat_cell(here.get(place), level) for place in places)))
    return HeatMap(policy, tuple(place or "all" for place in places), tuple(rows))


def _heat_cell(curve: PolicyCurve | None, level: int) -> HeatCell | None:
    if curve is None or level not in curve.curve.levels:
        return None
    place = curve.curve.levels.index(level)
    return HeatCell(curve.curve.rates[place], curve.episodes[place]) if curve.episodes[place] else None


def level(axis: str, severity: int) -> str:
    """`noise@4: 18.4 dB PSNR`, or `clean`."""
    if not severity:
        return "clean"
    known = AXES.get(axis)
    return f"{axis}@{severity}" + (f": {known.value(severity):g} {known.unit}" if known else "")


def heat_table(found: HeatMap) -> TextTable:
    """A heat map as text: rate, interval and episodes."""
    lines = [
        (level(row.axis, row.severity), *(f"{rate(c.rate)}, {c.episodes}" if c else NOTHING for c in row.cells))
        for row in found.rows
    ]
    return TextTable(("condition", *found.columns), tuple(lines), 1)


def tax_table(shift: Shift) -> TextTable:
    """What each other policy loses against the baseline at every level."""
    header = ("policy", "condition", shift.baseline, "policy's", "lost", "p", "p, adjusted", "e-value", "pairs")
    return TextTable(header, tuple(_tax_line(row) for row in shift.taxes), 2)


def _tax_line(row: TaxRow) -> tuple[str, ...]:
    return (
        *(row.policy, level(row.axis, row.severity), text.percent(row.baseline), text.percent(row.rate)),
        *(points(row.loss), p_value(row.p), p_value(row.adjusted), e_value(row.evidence), text.count(row.pairs)),
    )


def e_value(value: float) -> str:
    """`0.3`, `24`, or `>1,000,000`."""
    return ">1,000,000" if value > 1e6 else (f"{value:,.0f}" if value >= 10 else f"{value:.2g}")


def stopping(shift: Shift) -> str | None:
    """The rule by which conditions stopped, and what it did, in sentences; None if there was none."""
    rule = shift.rule
    if rule is None:
        return None
    said = (
        f"A condition stops when the e-value of {shift.baseline} against every other policy, over all tasks, reaches "
        f"{1 / rule.alpha:g}, looked at after every {text.counted(rule.round, 'seed')}; a comparison without a "
        f"difference is decided with a chance of {text.percent(rule.alpha)} at most. What that saves goes to the "
        f"undecided ones, up to {text.counted(rule.most, 'seed')} each, in an order drawn for each round. "
    )
    parts = [
        f"{level(row.axis, row.severity).partition(':')[0]} after {text.counted(row.seeds, 'seed')} per task "
        f"({row.policy}, e-value {e_value(row.evidence)})"
        for row in shift.decided
    ]
    return said + (f"Decided: {'; '.join(parts)}." if parts else "None was decided.")


def p_value(value: float) -> str:
    """`0.031`, or `<0.001`."""
    return "<0.001" if value < 0.001 else f"{value:.3f}"


def interaction_table(shift: Shift) -> TextTable:
    """Whether a policy loses more under an axis than in the clean world."""
    header = ("policy", "axis", "lost beyond clean", "all axes together", "tasks")
    lines = [
        (row.policy, short_title(row.axis), points(row.extra), _points_span(row.corrected), text.count(row.tasks))
        for row in shift.interactions
    ]
    return TextTable(header, tuple(lines), 2)


def _points_span(interval: Interval | None) -> str:
    return NOTHING if interval is None else f"[{100 * interval.low:.1f}, {100 * interval.high:.1f}]"


def interactions_of(shift: Shift) -> tuple[tuple[str, tuple[Interaction, ...]], ...]:
    """The interactions, policy by policy."""
    return tuple((policy, tuple(rows)) for policy, rows in groupby(shift.interactions, key=lambda row: row.policy))


def place(value: float) -> float:
    """Where a difference of rates stands on a forest plot, from 0 to 100."""
    return 50 + 50 * max(-1.0, min(1.0, value / REACH))


def router_table(shift: Shift) -> TextTable:
    """Router accuracy beside success at every level, and which gave way first."""
    lines = []
    for rows in _axes_of(shift):
        first = broke_first(rows) or "neither shown"
        for number, row in enumerate(rows):
            lines.append(
                (
                    *(row.policy, level(row.axis, row.severity) if row.severity else f"clean ({row.axis})"),
                    *(share(row.right), share(row.success), share(row.misrouted), "" if number else first),
                )
            )
    header = ("policy", "condition", "task inferred rightly", "success", "success where not", "gave way first")
    return TextTable(header, tuple(lines), 2)


def _axes_of(shift: Shift) -> list[Sequence[RouterRow]]:
    return [list(rows) for _, rows in groupby(shift.routers, key=lambda row: (row.policy, row.axis))]


def repeats(robustness: Robustness) -> str:
    """Whether episodes that were played twice ended alike, in a sentence."""
    if not robustness.repeats:
        return (
            "No clean episode was played twice (condition `again`): whether chance is in these numbers was not tested."
        )
    parts = [f"{row.alike:,} of {row.episodes:,} in {row.simulator}" for row in robustness.repeats]
    return f"Clean episodes played twice with the same actions and the same end, to the bit: {', '.join(parts)}."


def floors(robustness: Robustness) -> str | None:
    """What is taken off before shares are said, in a sentence; None if nothing is."""
    if not robustness.floors:
        return None
    names = " or ".join(robustness.floors)
    return f"Before area kept and half lost are found, what {names} achieves at the same level is taken off."


def worst_level(robustness: Robustness, policy: str) -> tuple[PolicyCurve, int] | None:
    """The curve and level at which a policy's success over all simulators is least."""
    found = [
        (estimate.value, -severity, curve)
        for axis in robustness.axes
        for curve in over_all(robustness, axis)
        if curve.policy == policy
        for severity, estimate in judged(curve.curve)
        if severity
    ]
    if not found:
        return None
    _, severity, curve = min(found, key=lambda item: item[:2])
    return curve, int(-severity)
