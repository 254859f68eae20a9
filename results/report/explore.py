"""`explore.html`: interactive plots of the report's numbers. Plotly is inside the file, so that it works offline."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any

from robogauntlet.results.analysis.robustness import PolicyCurve, Robustness
from robogauntlet.results.analysis.tables import Tables
from robogauntlet.results.report import formatting
from robogauntlet.results.report.condition_comparison import condition_text
from robogauntlet.results.report.formatting import escape_html
from robogauntlet.results.report.page import FOLDER, SERIES
from robogauntlet.results.report.robustness import axis_curves, axis_heading, known_rates, severity_text
from robogauntlet.results.report.templates import report_templates
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.statistics.rates import Interval
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import Condition
from robogauntlet.support.text import visible

SYMBOLS = ("circle", "square", "diamond", "triangle-up", "triangle-down", "cross")
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
"""Line styles of simulators; solid for all simulators."""
ALL = "all simulators"


def render_explorer(document: RunDocument, tables: Tables, robustness: Robustness) -> str:
    """Return the page as HTML (about 5 MB, mostly Plotly)."""
    from plotly.offline import get_plotlyjs

    curves = [curve for axis in robustness.axes for curve in axis_curves(robustness, axis)]
    last = (robustness.oracle_gate, *robustness.no_skill_baselines)
    simulators = sorted({curve.simulator for curve in curves if curve.simulator is not None})
    return (
        report_templates()
        .get_template("explore.html.jinja")
        .render(
            name=document.suite.name,
            axes=[(axis, axis_heading(axis)) for axis in dict.fromkeys(curve.axis for curve in curves)],
            policies=list(dict.fromkeys(curve.policy for curve in curves)),
            simulators=[ALL, *simulators],
            all_policies=sorted(tables.policies, key=lambda policy: policy in last),
            data={"axes": _axes(curves), "lines": _lines(curves, tables.policies), "maps": _maps(tables, last)},
            plotly=get_plotlyjs(),
            style=(FOLDER / "report.css").read_text(encoding="utf-8"),
            script=(FOLDER / "explore.js").read_text(encoding="utf-8"),
        )
    )


def _axes(curves: Sequence[PolicyCurve]) -> dict[str, Any]:
    """By axis, its unit and its severities with their levels."""
    axes: dict[str, Any] = {}
    for axis in dict.fromkeys(curve.axis for curve in curves):
        severities = sorted({int(level) for curve in curves if curve.axis == axis for level in curve.curve.levels})
        levels = [f"{s}<br>{AXES[axis].value(s):g}" if s and axis in AXES else str(s or "clean") for s in severities]
        unit = f", and its level in {AXES[axis].unit}" if axis in AXES else ""
        axes[axis] = {"severities": severities, "levels": levels, "title": f"severity{unit}"}
    return axes


def _lines(curves: Sequence[PolicyCurve], policies: Sequence[str]) -> list[dict[str, Any]]:
    """A line per policy, simulator and axis: success by severity, with 95 % intervals."""
    places = [None, *sorted({curve.simulator for curve in curves if curve.simulator is not None})]
    return [_line(found, policies.index(found.policy), places.index(found.simulator)) for found in curves]


def _line(found: PolicyCurve, colour: int, dash: int) -> dict[str, Any]:
    points = known_rates(found.curve)
    episodes = [n for n, rate in zip(found.episodes, found.curve.rates, strict=True) if not math.isnan(rate.value)]
    low, high = ([abs(_end(rate, end) - rate.value) for _, rate in points] for end in ("low", "high"))
    simulator = found.simulator or ALL
    name = escape_html(f"{found.policy}, {simulator}")
    return {
        "meta": {"axis": found.axis, "policy": found.policy, "simulator": simulator, "series": colour % SERIES},
        "type": "scatter",
        "name": name,
        "x": [level for level, _ in points],
        "y": [rate.value for _, rate in points],
        "error_y": {"type": "data", "symmetric": False, "array": high, "arrayminus": low, "thickness": 1},
        "mode": "lines+markers",
        "line": {"dash": DASHES[dash % len(DASHES)]},
        "marker": {"symbol": SYMBOLS[colour % len(SYMBOLS)], "size": 9},
        "customdata": [
            (
                *_texts(rate.value, rate.interval, n),
                severity_text(Condition(found.axis, int(level))) if level else "clean",
            )
            for (level, rate), n in zip(points, episodes, strict=True)
        ],
        "hovertemplate": f"{name}<br>severity %{{customdata[3]}}<br>"
        "%{customdata[0]} %{customdata[1]}, %{customdata[2]}<extra></extra>",
    }


def _texts(rate: float | None, interval: Interval | None, episodes: int) -> tuple[str, str, str]:
    """A rate, its interval and the episodes behind it, as a label and the table of values show them."""
    return formatting.percent(rate), formatting.span(interval), formatting.counted(episodes, "episode")


def _end(rate: Any, end: str) -> float:
    return rate.value if rate.interval is None else getattr(rate.interval, end)


def _maps(tables: Tables, last: Collection[str | None]) -> dict[str, Any]:
    """By policy, a heat map of tasks and conditions; those of `last` at the end."""
    tasks = list(dict.fromkeys(cell.task for cell in tables.cells))
    found = {(cell.policy, cell.task, cell.condition): cell.tally for cell in tables.cells}
    maps = {}
    for policy in sorted(tables.policies, key=lambda policy: policy in last):
        rows = [[found.get((policy, task, condition)) for task in tasks] for condition in tables.conditions]
        maps[policy] = {
            "z": [[None if one is None else one.rate for one in row] for row in rows],
            "customdata": [
                [("", "", "") if one is None else _texts(one.rate, one.interval, one.verdicts) for one in row]
                for row in rows
            ],
        }
    return {
        "tasks": list(map(visible, tasks)),
        "conditions": [str(condition) for condition in tables.conditions],
        "levels": [_level(condition) for condition in tables.conditions],
        "of": maps,
    }


def _level(condition: Condition) -> str:
    """A condition with its level and unit, if it has one."""
    return condition_text(condition.axis, condition.severity) if condition.axis in AXES else str(condition)
