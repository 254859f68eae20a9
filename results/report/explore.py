"""`explore.html`: interactive plots of the report's numbers. Plotly is inside the file, so that it works offline."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from robogauntlet.results.analysis.robustness import PolicyCurve, Robustness
from robogauntlet.results.analysis.tables import Tables
from robogauntlet.results.report import formatting
from robogauntlet.results.report.robustness import axis_curves, axis_heading, known_rates, severity_text
from robogauntlet.results.run_document import RunDocument
from robogauntlet.suites.episode import Condition

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#aa4499", "#b88700", "#56748c")
"""Colours of policies, as in the report; distinguishable with colour blindness."""
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "triangle-down", "cross")
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
"""Line styles of simulators; solid for all simulators."""
BLUES = ((0.0, "#ffffff"), (1.0, "#0072b2"))


def render_explorer(document: RunDocument, tables: Tables, robustness: Robustness) -> str:
    """Return the page as HTML (about 5 MB, mostly Plotly)."""
    from plotly.offline import get_plotlyjs

    name = escape(document.suite.name)
    parts = [
        _section(
            "Success by severity",
            "Choose the perturbation axis above the plot. Click a name in the legend to hide it; double-click to see "
            "it alone. Bars are 95 % intervals. Tasks have equal weight. Episodes that the oracle gate rejects do not "
            "count.",
            along_axes(robustness, tables.policies),
        ),
        _section(
            "Success by task and condition",
            "Choose the policy above the map. All episodes count here, including those that the oracle gate rejects. "
            "Grey cells have no episodes.",
            by_task(tables, last=(robustness.oracle_gate, *robustness.no_skill_baselines)),
        ),
    ]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{name}: explore</title>'
        f"<style>{_STYLE}</style><script>{get_plotlyjs()}</script></head><body>"
        f'<p><a href="report.html">Back to the report</a></p><h1>{name}</h1>{"".join(parts)}</body></html>\n'
    )


def along_axes(robustness: Robustness, policies: Sequence[str]) -> Figure:
    """Plot success by severity with a line per policy and simulator; a menu chooses the axis."""
    import plotly.graph_objects as go

    figure, axes_of_lines = go.Figure(), []
    places = [None, *sorted({curve.simulator for curve in robustness.curves if curve.simulator is not None})]
    for axis in robustness.axes:
        for found in axis_curves(robustness, axis):
            style = policies.index(found.policy) % len(COLOURS), places.index(found.simulator) % len(DASHES)
            figure.add_trace(_line(found, *style, shown=axis == robustness.axes[0]))
            axes_of_lines.append(axis)
    buttons = []
    for axis in robustness.axes:
        lines = zip(figure.data, axes_of_lines, strict=True)
        buttons.append(_button(axis_heading(axis), [_visibility(line, axis == of) for line, of in lines]))
    figure.update_xaxes(title="severity", dtick=1)
    figure.update_yaxes(title="success", range=[-0.03, 1.03], tickformat=".0%")
    return _lay_out(figure, buttons, height=560)


def _line(found: PolicyCurve, colour: int, dash: int, *, shown: bool) -> Any:
    import plotly.graph_objects as go

    points = known_rates(found.curve)
    episodes = [n for n, rate in zip(found.episodes, found.curve.rates, strict=True) if not math.isnan(rate.value)]
    low, high = ([abs(_end(rate, end) - rate.value) for _, rate in points] for end in ("low", "high"))
    name = f"{found.policy}, {found.simulator or 'all simulators'}"
    line = go.Scatter(
        name=name,
        x=[level for level, _ in points],
        y=[rate.value for _, rate in points],
        error_y={"type": "data", "symmetric": False, "array": high, "arrayminus": low, "thickness": 1},
        mode="lines+markers",
        line={"color": COLOURS[colour], "dash": DASHES[dash]},
        marker={"symbol": SYMBOLS[colour], "size": 9},
        customdata=[
            (formatting.span(rate.interval), n, severity_text(Condition(found.axis, int(level))) if level else "clean")
            for (level, rate), n in zip(points, episodes, strict=True)
        ],
        hovertemplate=f"{escape(name)}<br>severity %{{customdata[2]}}<br>"
        "%{y:.0%} %{customdata[0]}, %{customdata[1]} episodes<extra></extra>",
    )
    line.visible = _visibility(line, shown)
    return line


def _end(rate: Any, end: str) -> float:
    return rate.value if rate.interval is None else getattr(rate.interval, end)


def _visibility(line: Any, wanted: bool) -> bool | str:
    """Lines of single simulators are hidden until they are chosen in the legend."""
    if not wanted:
        return False
    return True if line.name.endswith(", all simulators") else "legendonly"


def by_task(tables: Tables, last: Collection[str | None]) -> Figure:
    """Draw a heat map of tasks and conditions; a menu chooses the policy, those of `last` at its end."""
    import plotly.graph_objects as go

    tasks = list(dict.fromkeys(cell.task for cell in tables.cells))
    conditions = [str(condition) for condition in tables.conditions]
    found = {(cell.policy, cell.task, str(cell.condition)): cell.tally for cell in tables.cells}
    figure, policies = go.Figure(), sorted(tables.policies, key=lambda policy: policy in last)
    for policy in policies:
        rows = [[found.get((policy, task, condition)) for task in tasks] for condition in conditions]
        figure.add_trace(
            go.Heatmap(
                x=[task.replace("/", "<br>") for task in tasks],
                y=conditions,
                z=[[None if one is None else one.rate for one in row] for row in rows],
                customdata=[
                    [("", 0) if one is None else (formatting.span(one.interval), one.verdicts) for one in row]
                    for row in rows
                ],
                hovertemplate="%{x}<br>%{y}: %{z:.0%} %{customdata[0]}, %{customdata[1]} episodes<extra></extra>",
                zmin=0,
                zmax=1,
                colorscale=BLUES,
                colorbar={"tickformat": ".0%", "title": "success"},
                xgap=1,
                ygap=1,
                visible=policy == policies[0],
            )
        )
    buttons = [_button(policy, [own == policy for own in policies]) for policy in policies]
    figure.update_yaxes(autorange="reversed", automargin=True, showgrid=False)
    figure.update_xaxes(automargin=True, showgrid=False, tickangle=0, tickfont={"size": 11})
    figure.update_layout(plot_bgcolor="#dfe3e6")  # where there is no result
    return _lay_out(figure, buttons, height=220 + 19 * len(conditions))  # px


def _button(label: str, visible: Sequence[bool | str]) -> dict[str, Any]:
    """A button of the menu that shows some lines or maps."""
    return {"label": label, "method": "update", "args": [{"visible": visible}]}


def _lay_out(figure: Figure, buttons: list[dict[str, Any]], *, height: int) -> Figure:
    menu = {"buttons": buttons, "x": 0, "xanchor": "left", "y": 1, "yanchor": "bottom", "pad": {"b": 12}}
    figure.update_layout(
        updatemenus=[menu], height=height, template="plotly_white", margin={"l": 60, "r": 20, "t": 70, "b": 60}
    )
    return figure


def _section(heading: str, description: str, figure: Figure) -> str:
    plot = figure.to_html(full_html=False, include_plotlyjs=False, config={"displaylogo": False, "responsive": True})
    return f"<section><h2>{escape(heading)}</h2><p>{escape(description)}</p>{plot}</section>"


_STYLE = """
body { max-width: 1150px; margin: 2rem auto; padding: 0 1rem; background: #ffffff; color: #1c2328; }
body { font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 2rem; } h2 { font-size: 1.3rem; margin-top: 2.5rem; }
p { max-width: 46rem; color: #5b6770; } a { color: #0b6e8a; }
"""
