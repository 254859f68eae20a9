"""A learning curve as a table, a sentence and a small page."""

from __future__ import annotations

from robogauntlet.results.analysis.learning_curve import LearningCurve
from robogauntlet.results.report.blocks import Line, LineChart, Point, Table
from robogauntlet.results.report.formatting import NOTHING, TextTable, count, counted, percent, rate, span
from robogauntlet.results.report.page import FOLDER, render_blocks
from robogauntlet.results.report.templates import report_templates, table_script

TICKS = 4
"""Parts into which labels divide the axis of steps."""


def table(curve: LearningCurve) -> TextTable:
    """A row per checkpoint, by step."""
    rows = []
    for point in curve.points:
        found = point.estimate
        value, interval = (NOTHING, NOTHING) if found is None else (percent(found.value), span(found.interval))
        rows.append((point.name, count(point.step), value, interval, count(point.count[1]), count(point.errors)))
    return TextTable(("checkpoint", "step", "success", "interval", "episodes", "errors"), tuple(rows), 1)


def best_sentence(curve: LearningCurve) -> str:
    """Which checkpoint is best, and its rate on the seeds on which it was not chosen."""
    if curve.best is None:
        return "best: none yet, no checkpoint has episodes on even and on odd seeds"
    name, (successes, trials) = curve.points[curve.best.index].name, curve.best.chosen_on
    measured = f"{rate(curve.best.estimate)} of {counted(curve.best.measured_on[1], 'episode')}"
    return f"best: {name}, chosen by even seeds ({percent(successes / trials)}), measured by odd seeds: {measured}"


def render_learning_curve(curve: LearningCurve, suite: str) -> str:
    """Return the page as HTML."""
    shown = Table(table(curve), "Success by checkpoint, 95 % Wilson intervals")
    return (
        report_templates()
        .get_template("learning_curve.html.jinja")
        .render(
            title=curve.policy,
            suite=suite,
            best=best_sentence(curve),
            content=render_blocks((_chart(curve), shown), (curve.policy,)),
            style=(FOLDER / "report.css").read_text(encoding="utf-8"),
            script=table_script(),
        )
    )


def _chart(curve: LearningCurve) -> LineChart:
    steps = [point.step for point in curve.points]
    first, last = min(steps, default=0), max(steps, default=0)
    width = (last - first) or 1
    ticks = [(100 * part / TICKS, count(first + width * part / TICKS)) for part in range(TICKS + 1)]
    made = []
    for point in curve.points:
        found = point.estimate
        if found is not None and found.interval is not None:
            text = f"{point.name}: {rate(found)}"
            at = 100 * (point.step - first) / width
            made.append(Point(at, 100 * found.value, 100 * found.interval.low, 100 * found.interval.high, text))
    label = f"{curve.policy}: success by step"
    lines = (Line(curve.policy, tuple(made)),)
    return LineChart(curve.policy, label, lines, tuple(ticks if first < last else ticks[:1]), "step", "success (%)")
