"""Worst cases as tables and as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from robogauntlet.results.report.formatting import NOTHING, TextTable, percent, span
from robogauntlet.results.statistics.boundary import INSIDE, Trials
from robogauntlet.results.statistics.rates import wilson_interval
from robogauntlet.results.statistics.worst_case import LARGEST, Disturbance, Point, WorstCases
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import AND, AT


def boundary_table(cases: Mapping[str, WorstCases]) -> TextTable:
    """Axes x tasks: the severity at which success crosses the share of the clean rate, with its physical value."""
    axes = dict.fromkeys(axis for found in cases.values() for axis in map(_name, found.axes))
    by_axis = [{_name(one): one for one in found.axes} for found in cases.values()]
    rows = [("clean success", *(_rate(found.clean_searched) for found in cases.values()))]
    rows += [(axis, *(_boundary(one[axis]) if axis in one else NOTHING for one in by_axis)) for axis in axes]
    if any(found.directions for found in cases.values()):
        rows.append(("combined", *(_combined(found) for found in cases.values())))
    return TextTable((f"boundary, {100 * INSIDE:.0f} % interval", *cases), tuple(rows), 1)


def confirmation_table(cases: Mapping[str, WorstCases], below: float) -> TextTable:
    """Every disturbance with its norm, its success on the seeds of the confirmation, and whether it is confirmed."""
    rows = []
    for task, found in cases.items():
        for one in (*found.axes, *([found.combined] if found.combined else ())):
            share = below * one.clean.successes / one.clean.trials if one.clean.trials else None
            rows.append(
                (task, point_text(one.point), f"{one.norm:.2f}", _rate(one.found), percent(share), verdict(one))
            )
    header = ("task", "disturbance", "norm", "success", f"{100 * below:g} % of clean", "verdict")
    return TextTable(header, tuple(rows), 2)


def smallest_text(found: WorstCases) -> str:
    """The smallest disturbance that was confirmed to break the policy, in words."""
    broken = [one for one in (*found.axes, found.combined) if one and one.breaks]
    confirmed = min((one for one in broken if one.is_confirmed), key=lambda one: one.norm, default=None)
    if confirmed is not None:
        size = f"{point_text(confirmed.point)}, norm {confirmed.norm:.2f}"
        return f"the smallest disturbance that is confirmed to break the policy is {size}"
    return "nothing was found that breaks the policy" if not broken else "what was found is not confirmed"


def verdict(one: Disturbance) -> str:
    """What the confirmation says of what the search found."""
    if not one.is_proposed and not one.is_confirmed:
        return "too few episodes to tell"
    if not one.is_confirmed:
        return f"not confirmed ({'breaks' if one.breaks else 'holds'})"
    return "breaks" if one.breaks else "holds"


def point_text(point: Point) -> str:
    """`noise@2+table@3.5`."""
    return AND.join(f"{axis}{AT}{severity:g}" for axis, severity in point)


def plain_cases(found: WorstCases) -> dict[str, Any]:
    """Return what was found as JSON has it."""
    return {
        "episodes": found.episodes,
        "clean": {"search": _plain_rate(found.clean_searched), "confirmation": _plain_rate(found.clean)},
        "axes": [_plain(one) for one in found.axes],
        "directions": found.directions,
        "combined": _plain(found.combined) if found.combined else None,
    }


def _plain(one: Disturbance) -> dict[str, Any]:
    is_alone = len(one.direction) == 1
    boundary = {"value": one.boundary.value, "low": one.boundary.low, "high": one.boundary.high}
    physical = {"physical": _physical(_name(one), one.boundary.value)} if is_alone else {}
    return {
        "direction": dict(one.direction),
        "boundary": boundary | physical,
        "episodes": one.searched,
        "disturbance": point_text(one.point),
        "norm": round(one.norm, 4),
        "values": {axis: AXES[axis].describe(severity) for axis, severity in one.point},
        "breaks": one.breaks,
        "proposed": one.is_proposed,
        "success": _plain_rate(one.found),
        "clean": _plain_rate(one.clean),
        "confirmed": one.is_confirmed,
    }


def _plain_rate(found: Trials) -> dict[str, Any]:
    interval = wilson_interval(found.successes, found.trials)
    ends = {"low": interval.low, "high": interval.high} if interval else {"low": None, "high": None}
    return {"successes": found.successes, "trials": found.trials, **ends}


def _name(one: Disturbance) -> str:
    return one.direction[0][0]


def _rate(found: Trials) -> str:
    if not found.trials:
        return NOTHING
    return f"{percent(found.successes / found.trials)} {span(wilson_interval(found.successes, found.trials))}"


def _boundary(one: Disturbance) -> str:
    value = one.boundary.value
    if value is None:
        return f">{LARGEST:g}"
    ends = (f"{end:.1f}" if end is not None else f">{LARGEST:g}" for end in (one.boundary.low, one.boundary.high))
    return f"{value:.1f} [{', '.join(ends)}], {_physical(_name(one), value)}"


def _physical(axis: str, severity: float | None) -> str | None:
    """The axis' value there; of an axis with whole severities, at the next whole one."""
    if severity is None:
        return None
    whole = AXES[axis].unchanged is None
    return AXES[axis].describe(math.ceil(severity) if whole else round(severity, 2))


def _combined(found: WorstCases) -> str:
    if found.combined is None or found.combined.boundary.value is None:
        return f"none in {found.directions} directions"
    at = AND.join(f"{axis}{AT}{part * found.combined.boundary.value:.1f}" for axis, part in found.combined.direction)
    return f"norm {found.combined.boundary.value:.1f}: {at}"
