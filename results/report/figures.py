"""Figures of a report for papers and slides: SVG, PDF or PNG, one column of a paper wide.

They are the plots of its sections, drawn by matplotlib from the same blocks as those of the page.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import StrEnum
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from robogauntlet.results.report import formatting
from robogauntlet.results.report.blocks import (
    Block,
    Charts,
    Fold,
    Forest,
    HeatMap,
    IntervalPlot,
    Line,
    LineChart,
    RatePlot,
    StackedBars,
)
from robogauntlet.results.report.figure_style import (
    COLOURS,
    GRID,
    HEAT_COLOURS,
    LINES,
    MARKERS,
    PHASE_COLOURS,
    STYLE,
    draw_legend,
    mixed,
    new_figure,
)
from robogauntlet.results.report.media import Media
from robogauntlet.results.report.section import Page, Report
from robogauntlet.results.report.write import show
from robogauntlet.support.errors import BadInput
from robogauntlet.support.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FOLDER = "figures"
TASKS, SEVERITY, WORKER_TIME = "success-by-task", "success-by-severity", "worker-time"
COMPARISON = "comparison"
NUMBERED = (COMPARISON, "heat-map", "losses", "sensitivity", "confusion", "reliability")
LONGEST = 60
"""Characters of the names of policies in the name of a file."""
WIDTH = 62
"""Characters of a note that fit a column."""
Drawing = Callable[[], "Figure"]


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


_OWN_NAME = re.compile(f"{TASKS}|{SEVERITY}|{WORKER_TIME}|{COMPARISON}|({'|'.join(NUMBERED)})-[0-9]+-.*")


def _figures(report: Report) -> Iterator[tuple[str, Drawing]]:
    """Name and drawing function of each figure of a run, in the order of the report."""
    series = {policy: place % len(COLOURS) for place, policy in enumerate(report.tables.policies)}
    chapters = show(report, Page(report.paths.html.parent, report, Media()))
    numbers: dict[str, int] = {}
    for chapter in chapters:
        for kind, about, draw in _drawn([*_flat(chapter.blocks)], series):
            if about:
                numbers[kind] = numbers.get(kind, 0) + 1
                about = re.sub(r"[^A-Za-z0-9_.-]+", "-", about)[:LONGEST].strip("-.")
            yield f"{kind}-{numbers[kind]}-{about}" if about else kind, draw


def _flat(blocks: Iterable[Block]) -> Iterator[Block]:
    for block in blocks:
        if isinstance(block, Fold):
            yield from _flat(block.blocks)
        else:
            yield block


def _drawn(blocks: Sequence[Block], series: dict[str, int]) -> Iterator[tuple[str, str, Drawing]]:
    """Kind, subject and drawing function of each figure of a section."""
    rates = [block for block in blocks if isinstance(block, RatePlot) and block.figure and block.groups]
    if rates:
        yield TASKS, "", partial(_rates, rates, series)
    for block in blocks:
        if isinstance(block, Forest):
            yield COMPARISON, block.about, partial(_differences, block)
        elif isinstance(block, HeatMap):
            yield from _heat_maps(block)
        elif isinstance(block, StackedBars) and block.figure and block.bars:
            yield block.figure, "", partial(_bars, block)
        elif isinstance(block, Charts) and block.items:
            first = block.items[0]
            lines = [item for item in block.items if isinstance(item, LineChart)]
            if isinstance(first, LineChart):
                yield first.figure, first.about, partial(_lines, lines, series)
            for item in block.items:
                if isinstance(item, IntervalPlot):
                    yield item.figure, item.policy, partial(_intervals, item, series)


def _rates(plots: Sequence[RatePlot], series: dict[str, int]) -> Figure:
    """Rates with 95 % Wilson intervals: a panel per simulator, a group of lines per task, a line per policy."""
    shown = {policy for plot in plots for group in plot.groups for policy, tally in group.rows if tally.verdicts}
    policies = [policy for policy in series if policy in shown]
    heights = [len(plot.groups) for plot in plots]
    height = max(0.16, 0.11 * (len(policies) + 1)) * sum(heights) + 0.3 * len(heights) + 0.5
    figure, panels = new_figure(height, len(heights), sharex=True, height_ratios=heights)
    for panel, plot in zip(panels[:, 0], plots, strict=True):
        for place, policy in enumerate(policies):
            colour, marker = COLOURS[series[policy]], MARKERS[series[policy]]
            for number, group in enumerate(plot.groups):
                y = number - 0.5 + (place + 1) / (len(policies) + 1)
                tally = dict(group.rows).get(policy)
                if tally is None or tally.interval is None or tally.rate is None:
                    continue
                panel.hlines(y, 100 * tally.interval.low, 100 * tally.interval.high, colors=colour, zorder=3)
                panel.plot(100 * tally.rate, y, marker, color=colour, markersize=3.5, zorder=4, clip_on=False)
            panel.plot([], [], marker, color=colour, markersize=3.5, label=policy)
        _set_rows(panel, [formatting.short_task(group.name) for group in plot.groups])
        panel.set_title(plot.title, loc="left", fontweight="bold", pad=3)
        panel.set_xticks(range(0, 101, 25))
        for border in range(1, len(plot.groups)):
            panel.axhline(border - 0.5, **GRID)
    panels[-1, 0].set_xlabel("success (%), 95 % Wilson interval")
    draw_legend(figure, panels[:, 0], policies)
    return figure


def _set_rows(panel: Axes, names: Sequence[str]) -> None:
    panel.set_yticks(range(len(names)), names)
    panel.set_ylim(len(names) - 0.5, -0.5)
    panel.tick_params(axis="y", length=0)
    panel.grid(axis="x", **GRID)
    panel.set_xlim(0, 100)


def _lines(charts: Sequence[LineChart], series: dict[str, int]) -> Figure:
    """Charts side by side: a line with its 95 % band per policy, or points with intervals around the diagonal."""
    columns = min(2, len(charts)) if not charts[0].has_diagonal else 1
    rows = (len(charts) + columns - 1) // columns
    figure, panels = new_figure(2.6 if columns == 1 else 1.3 * rows + 0.35, rows, columns, sharey=True)
    for chart, panel in zip(charts, panels.flat, strict=False):
        for line in chart.lines:
            _draw_line(panel, line, series.get(line.policy, 0), has_band=not chart.has_diagonal)
        if chart.has_diagonal:
            panel.plot((0, 100), (0, 100), "--", color="#8a949c", linewidth=0.6, zorder=1)
        panel.set_title(chart.title, loc="left", fontweight="bold", pad=3)
        panel.set_xticks(*zip(*chart.ticks, strict=True))
        panel.set_xlabel(chart.x_label)
        panel.set_xlim(0, 100)
        panel.set_ylim(0, 100)
        panel.set_yticks(range(0, 101, 25))
        panel.grid(axis="y", **GRID)
    for panel in panels.flat[len(charts) :]:
        panel.set_axis_off()
    for row in panels:
        row[0].set_ylabel(charts[0].y_label)
    shown = {line.policy for chart in charts for line in chart.lines}
    if not charts[0].has_diagonal:
        draw_legend(figure, panels.flat, [policy for policy in series if policy in shown])
    return figure


def _draw_line(panel: Axes, line: Line, place: int, *, has_band: bool) -> None:
    colour, xs = COLOURS[place], [point.x for point in line.points]
    low = [point.y if point.low is None else point.low for point in line.points]
    high = [point.y if point.high is None else point.high for point in line.points]
    if has_band:
        panel.fill_between(xs, low, high, alpha=0.16, linewidth=0, zorder=2, color=colour)
    else:
        panel.vlines(xs, low, high, colors=colour, zorder=3)
    panel.plot(
        xs,
        [point.y for point in line.points],
        marker=MARKERS[place],
        linestyle=LINES[place] if has_band else "",
        markersize=3.2,
        label=line.policy,
        zorder=3,
        clip_on=False,
        color=colour,
    )


def _heat_maps(block: HeatMap) -> Iterator[tuple[str, str, Drawing]]:
    """A figure per group of columns."""
    start = 0
    groups = block.groups or ((block.about, len(block.columns), None),)
    for name, columns, _ in groups if block.figure else ():
        yield block.figure, name, partial(_heat_map, block, name, slice(start, start + columns))
        start += columns


def _heat_map(block: HeatMap, name: str, shown: slice) -> Figure:
    """Shares as colours, with their texts."""
    columns = block.columns[shown]
    cells = [line[shown] for _, line in block.rows]
    figure, panels = new_figure(0.14 * len(cells) + 0.75 + (0.4 if len(columns) > 4 else 0))
    panel = panels[0, 0]
    colours = [
        [mixed(HEAT_COLOURS[cell.kind], 1.0 if cell.kind == "nothing" else cell.share) for cell in line]
        for line in cells
    ]
    panel.imshow(colours, aspect="auto", interpolation="nearest")
    for y, line in enumerate(cells):
        for x, cell in enumerate(line):
            text = formatting.NOTHING if cell.kind == "nothing" else cell.text.removesuffix(" %")
            panel.text(x, y, text, ha="center", va="center", fontsize=6)
    panel.set_yticks(range(len(cells)), [row for row, _ in block.rows])
    panel.set_xticks(range(len(columns)), columns, rotation=90 if len(columns) > 4 else 0)
    panel.tick_params(length=0, labelsize=6)
    panel.xaxis.tick_top()
    panel.spines[:].set_visible(False)
    panel.set_title(f"{name}: {block.unit}", loc="left", fontweight="bold")
    return figure


def _differences(forest: Forest) -> Figure:
    """Differences of success with their intervals: a panel per simulator, diamonds for several tasks together."""
    heights = [len(group.rows) for group in forest.groups]
    note = textwrap.fill(forest.note, WIDTH)
    titles = sum(bool(group.name) for group in forest.groups)
    height = 0.17 * sum(heights) + 0.25 * titles + 0.11 * note.count("\n") + 0.75
    figure, panels = new_figure(height, len(heights), sharex=True, height_ratios=heights)
    for panel, group in zip(panels[:, 0], forest.groups, strict=True):
        for y, row in enumerate(group.rows):
            panel.hlines(y, row.low, row.high, colors=COLOURS[0], zorder=3)
            face, shape = (COLOURS[0] if row.is_shown else "white"), ("D" if row.is_pooled else "s")
            style = {"markerfacecolor": face, "markersize": 3.5, "zorder": 4, "clip_on": False}
            panel.plot(row.at, y, shape, color=COLOURS[0], **style)
            panel.text(102, y, row.value, va="center", fontsize=6, fontweight="bold" if row.is_pooled else "normal")
        if forest.margin is not None:
            panel.axvline(forest.margin, color=COLOURS[1], linewidth=0.8, linestyle="--", zorder=2)
        if group.name:
            panel.set_title(group.name, loc="left", fontweight="bold", pad=3)
        _set_rows(panel, [row.name for row in group.rows])
        panel.axvline(50, color="#5b6770", linewidth=0.6, zorder=1)
        panel.set_xticks((0, 25, 50, 75, 100), forest.ticks)
    panels[-1, 0].set_xlabel(f"difference of success (percentage points)\n{note}")
    figure.suptitle(forest.title, fontsize=7, fontweight="bold")
    return figure


def _intervals(plot: IntervalPlot, series: dict[str, int]) -> Figure:
    """Estimates row by row; thin lines: intervals that are corrected for their number."""
    figure, panels = new_figure(0.17 * len(plot.rows) + 0.75)
    panel, place = panels[0, 0], series.get(plot.policy, 0)
    for y, (_, mark) in enumerate(plot.rows):
        for ends, width in ((mark.wide, 0.6), (mark.interval, 1.6)):
            if ends is not None:
                panel.hlines(y, *ends, colors=COLOURS[place], linewidth=width, zorder=3)
        panel.plot(mark.at, y, MARKERS[place], color=COLOURS[place], clip_on=False, markersize=3.5, zorder=4)
        panel.text(102, y, mark.text.partition(": ")[2], va="center", fontsize=6)
    _set_rows(panel, [name for name, _ in plot.rows])
    panel.set_xticks(*zip(*plot.ticks, strict=True))
    panel.set_xlabel(plot.x_label)
    panel.set_title(plot.policy, loc="left", fontweight="bold")
    return figure


def _bars(block: StackedBars) -> Figure:
    """Shares of wholes, with the wholes beside them."""
    figure, panels = new_figure(0.24 * len(block.bars) + 0.75)
    panel = panels[0, 0]
    drawn = []
    for name, colour in PHASE_COLOURS.items():
        parts = [(y, part) for y, bar in enumerate(block.bars) for part in bar.segments if part.name == name]
        for y, part in parts:
            panel.barh(y, part.width, 0.7, left=part.start, color=colour, label=name)
        drawn += [name] if parts else []
    for y, bar in enumerate(block.bars):
        panel.text(102, y, bar.value, va="center", fontsize=6)
    _set_rows(panel, [bar.name for bar in block.bars])
    panel.set_xticks(range(0, 101, 25))
    panel.set_xlabel("worker time (%)")
    draw_legend(figure, [panel], drawn, columns=4)
    return figure
