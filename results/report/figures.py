"""Figures of a report for papers and slides: SVG, PDF or PNG, one column of a paper wide."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.pairwise import PairwiseComparisons
from robogauntlet.results.analysis.robustness import PolicyCurve, Robustness
from robogauntlet.results.analysis.tables import CellRow, Tables, Tally
from robogauntlet.results.analysis.timing import PHASES, PhaseTiming
from robogauntlet.results.report import formatting
from robogauntlet.results.report.comparison_figures import differences, losses
from robogauntlet.results.report.condition_comparison import HeatMap, condition_text, heat_maps, interactions_of
from robogauntlet.results.report.figure_style import (
    COLOURS,
    GRID,
    LINES,
    MARKERS,
    PHASE_COLOURS,
    STYLE,
    draw_legend,
    new_figure,
)
from robogauntlet.results.report.pairwise import overview_forest, task_forest, title
from robogauntlet.results.report.robustness import axis_heading, known_rates, overall_curves
from robogauntlet.results.report.routing_figures import confusion, reliability
from robogauntlet.results.report.summary import Report
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import Condition
from robogauntlet.support.errors import BadInput
from robogauntlet.support.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FOLDER = "figures"
TASKS, SEVERITY, WORKER_TIME = "success-by-task", "success-by-severity", "worker-time"
MAPS, COMPARISONS, LOSSES = "heat-map", "comparison", "losses"
CONFUSION, RELIABILITY = "confusion", "reliability"
LONGEST = 60
"""Characters of the names of policies in the name of a file."""


class FigureFormat(StrEnum):
    """File format of the figures."""

    SVG = "svg"
    PDF = "pdf"
    PNG = "png"


def check_matplotlib() -> None:
    """Raise BadInput if matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise BadInput('--figures needs matplotlib; install it: pip install "robogauntlet[figures]"')


def write_figures(report: Report, folder: Path, form: FigureFormat) -> list[Path]:
    """Write the plots of a report into a folder, and return their paths.

    `success-by-task` is a forest plot under the first condition, `comparison` one of the differences of policies. Runs
    with perturbations also have `success-by-severity`, a heat map of conditions and simulators per policy, and forest
    plots of what is lost beyond the clean loss; routed policies their confusions and their reliability.

    Figures that an earlier call wrote in this format and that the report has no more are removed. Other files stay.

    Raises:
        BadInput: matplotlib is not installed.
        OSError: The folder cannot be written.
    """
    check_matplotlib()
    from matplotlib import rc_context

    folder.mkdir(exist_ok=True)
    written = []
    with rc_context(STYLE):
        for name, draw in _figures(report):
            path = folder / f"{name}.{form}"
            # A date in the file would make equal figures differ.
            dates = {FigureFormat.SVG: {"Date": None}, FigureFormat.PDF: {"CreationDate": None}}
            made = dates.get(form, {})
            with replacing(path) as file:
                draw().savefig(file, format=str(form), metadata=made, bbox_inches="tight", pad_inches=0.02)
            written.append(path)
    for path in set(folder.glob(f"*.{form}")) - set(written):
        if _OWN_NAME.fullmatch(path.stem) and not path.is_dir():
            path.unlink()
    return written


_OWN_NAME = re.compile(
    f"{TASKS}|{SEVERITY}|{WORKER_TIME}|{COMPARISONS}|({MAPS}|{COMPARISONS}|{LOSSES}|{CONFUSION}|{RELIABILITY})-[0-9]+-.*"
)


def _figures(report: Report) -> Iterator[tuple[str, Callable[[], Figure]]]:
    """Name and drawing function of each figure of a run, in the order of the report."""
    tables, robustness = report.tables, report.robustness
    series = {policy: place for place, policy in enumerate(tables.policies)}
    if any(cell.tally.verdicts for cell in _shown(tables)):
        yield TASKS, partial(_forest, tables)
    if report.pairwise is not None:
        yield from _comparisons(report.pairwise)
    if robustness is not None:
        if any(overall_curves(robustness, axis) for axis in robustness.axes):
            yield SEVERITY, partial(_curves, robustness, tables.policies)
        for number, found in enumerate(heat_maps(robustness), start=1):
            yield _name(MAPS, number, found.policy), partial(_heat_map, found)
        if robustness.condition_comparison is not None:
            for number, (policy, rows) in enumerate(interactions_of(robustness.condition_comparison), start=1):
                baseline = robustness.condition_comparison.baseline
                yield _name(LOSSES, number, policy), partial(losses, policy, baseline, rows, series[policy])
    routed = () if report.merging is None else report.merging.routed
    for number, one in enumerate(routed, start=1):
        if one.router is not None:
            yield _name(CONFUSION, number, one.policy), partial(confusion, one.policy, one.router.confusion)
            if one.router.calibration is not None:
                drawn = partial(reliability, one.policy, one.router.calibration, series[one.policy])
                yield _name(RELIABILITY, number, one.policy), drawn
    if any(line.total_s > 0 for line in tables.timing):
        yield WORKER_TIME, partial(_worker_time, tables.timing)


def _comparisons(found: PairwiseComparisons) -> Iterator[tuple[str, Callable[[], Figure]]]:
    if len(found.comparisons) > 1:
        yield COMPARISONS, partial(differences, overview_forest(found))
    for number, one in enumerate(found.comparisons, start=1):
        yield _name(COMPARISONS, number, title(one)), partial(differences, task_forest(one, found))


def _name(kind: str, number: int, policies: str) -> str:
    return f"{kind}-{number}-{re.sub(r'[^A-Za-z0-9_.-]+', '-', policies)[:LONGEST].strip('-.')}"


def _shown(tables: Tables) -> list[CellRow]:
    """Cells under the condition that the report's forest plot has: clean, or the first of the plan."""
    shown = tables.conditions[0] if tables.conditions else Condition()
    return [cell for cell in tables.cells if cell.condition == shown]


def _forest(tables: Tables) -> Figure:
    """Rates with 95 % Wilson intervals: a panel per simulator, a group of lines per task, a line per policy."""
    cells = [cell for cell in _shown(tables) if cell.tally.verdicts]
    policies = [policy for policy in tables.policies if any(cell.policy == policy for cell in cells)]
    tasks: dict[str, list[str]] = {}
    for cell in cells:
        of_simulator = tasks.setdefault(cell.simulator, [])
        of_simulator += [] if cell.task in of_simulator else [cell.task]
    heights = [len(names) for names in tasks.values()]
    height = max(0.16, 0.11 * (len(policies) + 1)) * sum(heights) + 0.3 * len(heights) + 0.5
    figure, panels = new_figure(height, len(heights), sharex=True, height_ratios=heights)
    for panel, (simulator, names) in zip(panels[:, 0], tasks.items(), strict=True):
        for place, policy in enumerate(policies):
            lines = [
                (names.index(cell.task) - 0.5 + (place + 1) / (len(policies) + 1), cell.tally)
                for cell in cells
                if cell.simulator == simulator and cell.policy == policy
            ]
            _draw_rates(panel, policy, place, lines)
        panel.set_yticks(range(len(names)), [formatting.short_task(name) for name in names])
        panel.set_ylim(len(names) - 0.5, -0.5)
        panel.set_title(simulator, loc="left", fontweight="bold", pad=3)
        panel.set_xlim(0, 100)
        panel.set_xticks(range(0, 101, 25))
        panel.grid(axis="x", **GRID)
        for border in range(1, len(names)):
            panel.axhline(border - 0.5, **GRID)
        panel.tick_params(axis="y", length=0)
    panels[-1, 0].set_xlabel("success (%), 95 % Wilson interval")
    draw_legend(figure, panels[:, 0], policies)
    return figure


def _draw_rates(panel: Axes, policy: str, place: int, lines: Sequence[tuple[float, Tally]]) -> None:
    colour = COLOURS[place % len(COLOURS)]
    for y, tally in lines:
        if tally.interval is not None:
            panel.hlines(y, 100 * tally.interval.low, 100 * tally.interval.high, colors=colour, zorder=3)
    panel.plot(
        [100 * (tally.rate or 0.0) for _, tally in lines],
        [y for y, _ in lines],
        MARKERS[place % len(MARKERS)],
        color=colour,
        markersize=3.5,
        label=policy,
        zorder=4,
        clip_on=False,
    )


def _curves(robustness: Robustness, order: Sequence[str]) -> Figure:
    """Success by severity over all simulators: a panel per axis, a line with its 95 % band per policy."""
    axes = [axis for axis in robustness.axes if overall_curves(robustness, axis)]
    rows = (len(axes) + 1) // 2
    figure, panels = new_figure(1.3 * rows + 0.35, rows, 2, sharey=True)
    places = {policy: place for place, policy in enumerate(order)}
    drawn: dict[str, None] = {}
    for axis, panel in zip(axes, panels.flat, strict=False):
        curves = overall_curves(robustness, axis)
        for curve in curves:
            _draw_curve(panel, curve, places.get(curve.policy, 0))
            drawn[curve.policy] = None
        levels = sorted({int(level) for curve in curves for level in curve.curve.levels})
        panel.set_xticks(levels, [_level(axis, level) for level in levels])
        panel.set_xlabel(axis_heading(axis))
        panel.set_ylim(0, 102)
        panel.set_yticks(range(0, 101, 25))
        panel.grid(axis="y", **GRID)
    for panel in panels.flat[len(axes) :]:
        panel.set_axis_off()
    for row in panels:
        row[0].set_ylabel("success (%)")
    draw_legend(figure, panels.flat, [policy for policy in order if policy in drawn])
    return figure


def _draw_curve(panel: Axes, found: PolicyCurve, place: int) -> None:
    points = known_rates(found.curve)
    colour = COLOURS[place % len(COLOURS)]
    levels = [level for level, _ in points]
    panel.plot(
        levels,
        [100 * rate.value for _, rate in points],
        marker=MARKERS[place % len(MARKERS)],
        linestyle=LINES[place % len(LINES)],
        markersize=3.2,
        label=found.policy,
        zorder=3,
        clip_on=False,
        color=colour,
    )
    ends = [rate.interval for _, rate in points]
    low = [100 * (end.low if end else rate.value) for end, (_, rate) in zip(ends, points, strict=True)]
    high = [100 * (end.high if end else rate.value) for end, (_, rate) in zip(ends, points, strict=True)]
    panel.fill_between(levels, low, high, alpha=0.16, linewidth=0, zorder=2, color=colour)


def _level(axis: str, severity: int) -> str:
    """The label of a severity: its physical value."""
    if not severity:
        return "clean"
    return f"{AXES[axis].value(severity):g}" if axis in AXES else str(severity)


def _heat_map(found: HeatMap) -> Figure:
    """One policy's success (%) with the number of episodes behind it: conditions in rows, simulators in columns."""
    from matplotlib.colors import LinearSegmentedColormap

    values = [[float("nan") if cell is None else 100 * cell.rate.value for cell in row.cells] for row in found.rows]
    figure, panels = new_figure(0.125 * len(found.rows) + 0.75)
    panel = panels[0, 0]
    # The darkest colour is light enough for black numbers.
    colours = LinearSegmentedColormap.from_list("success", ("#ffffff", "#5f9fcf"), bad="#e3e6e8")
    panel.imshow(values, cmap=colours, vmin=0, vmax=100, aspect="auto", interpolation="nearest")
    for y, row in enumerate(found.rows):
        for x, cell in enumerate(row.cells):
            text = formatting.NOTHING if cell is None else formatting.percent(cell.rate.value).removesuffix(" %")
            panel.text(x, y, text, ha="center", va="center", fontsize=6)
    panel.set_yticks(range(len(found.rows)), [condition_text(row.axis, row.severity) for row in found.rows])
    panel.set_xticks(range(len(found.columns)), found.columns)
    panel.tick_params(length=0, labelsize=6)
    panel.xaxis.tick_top()
    panel.spines[:].set_visible(False)
    borders = [y for y in range(1, len(found.rows)) if found.rows[y].axis != found.rows[y - 1].axis]
    for y in {1, *borders} if len(found.rows) > 1 else ():
        panel.axhline(y - 0.5, color="#5b6770", linewidth=0.5)
    panel.set_title(f"{found.policy}: success (%)", loc="left", fontweight="bold")
    return figure


def _worker_time(timing: Sequence[PhaseTiming]) -> Figure:
    """Shares of each simulator's worker time by phase, with the total beside them."""
    lines = [line for line in timing if line.total_s > 0]
    figure, panels = new_figure(0.24 * len(lines) + 0.75)
    panel = panels[0, 0]
    at = [0.0] * len(lines)
    drawn = []
    for phase in PHASES:
        shares = [100 * line.seconds(phase) / line.total_s for line in lines]
        if any(shares):
            panel.barh(range(len(lines)), shares, 0.7, left=at, color=PHASE_COLOURS[phase], label=phase)
            drawn.append(phase)
        at = [start + share for start, share in zip(at, shares, strict=True)]
    for y, line in enumerate(lines):
        panel.text(102, y, formatting.seconds(line.total_s), va="center", fontsize=6)
    panel.set_yticks(range(len(lines)), [line.simulator for line in lines])
    panel.set_ylim(len(lines) - 0.5, -0.5)
    panel.set_xlim(0, 100)
    panel.set_xticks(range(0, 101, 25))
    panel.set_xlabel("worker time (%)")
    panel.tick_params(axis="y", length=0)
    draw_legend(figure, [panel], drawn, columns=4)
    return figure
