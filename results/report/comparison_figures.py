"""Figures of policies against each other: differences of success, and losses under perturbations."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.condition_comparison import Interaction
from robogauntlet.results.report import formatting
from robogauntlet.results.report.condition_comparison import plot_position
from robogauntlet.results.report.figure_style import COLOURS, GRID, MARKERS, new_figure
from robogauntlet.results.report.pairwise import Forest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH = 62
"""Characters of a note that fit a column."""
PLACES = (0, 25, 50, 75, 100)
"""Of the five ticks, in the units of `Forest`: 50 is no difference."""


def differences(forest: Forest) -> Figure:
    """Differences of success with their intervals: a panel per simulator, diamonds for several tasks together."""
    heights = [len(group.rows) for group in forest.groups]
    note = textwrap.fill(forest.note, WIDTH)
    titles = sum(bool(group.name) for group in forest.groups)
    height = 0.17 * sum(heights) + 0.25 * titles + 0.11 * note.count("\n") + 0.75
    figure, panels = new_figure(height, len(heights), sharex=True, height_ratios=heights)
    for panel, group in zip(panels[:, 0], forest.groups, strict=True):
        for y, row in enumerate(group.rows):
            panel.hlines(y, row.low, row.high, colors=COLOURS[0], zorder=3)
            face = COLOURS[0] if row.is_shown else "white"
            shape = "D" if row.is_pooled else "s"
            panel.plot(
                row.at, y, shape, color=COLOURS[0], markerfacecolor=face, markersize=3.5, zorder=4, clip_on=False
            )
            panel.text(102, y, row.value, va="center", fontsize=6, fontweight="bold" if row.is_pooled else "normal")
        if forest.margin is not None:
            panel.axvline(forest.margin, color=COLOURS[1], linewidth=0.8, linestyle="--", zorder=2)
        if group.name:
            panel.set_title(group.name, loc="left", fontweight="bold", pad=3)
        _set_rows(panel, [row.name for row in group.rows])
        panel.set_xlim(0, 100)
        panel.set_xticks(PLACES, forest.ticks)
    panels[-1, 0].set_xlabel(f"difference of success (percentage points)\n{note}")
    figure.suptitle(forest.title, fontsize=7, fontweight="bold")
    return figure


def losses(policy: str, baseline: str, rows: Sequence[Interaction], place: int) -> Figure:
    """Success lost against the baseline beyond the clean loss, axis by axis; thin lines: simultaneous intervals."""
    figure, panels = new_figure(0.17 * len(rows) + 0.75)
    panel, colour = panels[0, 0], COLOURS[place % len(COLOURS)]
    for y, row in enumerate(rows):
        for ends, width in ((row.corrected, 0.6), (row.extra.interval, 1.6)):
            if ends is not None:
                panel.hlines(y, *map(plot_position, (ends.low, ends.high)), colors=colour, linewidth=width, zorder=3)
        marker = MARKERS[place % len(MARKERS)]
        panel.plot(plot_position(row.extra.value), y, marker, color=colour, markersize=3.5, zorder=4, clip_on=False)
        panel.text(102, y, formatting.points(row.extra), va="center", fontsize=6)
    _set_rows(panel, [row.axis for row in rows])
    panel.set_xlim(0, 100)
    panel.set_xticks(PLACES, ("-50", "-25", "0", "+25", "+50"))
    panel.set_xlabel(f"lost against {baseline} beyond clean (percentage points)")
    panel.set_title(policy, loc="left", fontweight="bold")
    return figure


def _set_rows(panel: Axes, names: Sequence[str]) -> None:
    panel.set_yticks(range(len(names)), names)
    panel.set_ylim(len(names) - 0.5, -0.5)
    panel.tick_params(axis="y", length=0)
    panel.grid(axis="x", **GRID)
    panel.axvline(50, color="#5b6770", linewidth=0.6, zorder=1)
