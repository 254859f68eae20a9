"""Figures of routers: which task they inferred, and whether their probabilities agree with their accuracy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robogauntlet.results.analysis.routing import Calibration, Confusion
from robogauntlet.results.report import formatting
from robogauntlet.results.report.figure_style import COLOURS, GRID, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RIGHT, WRONG = "#5f9fcf", "#eea47a"
"""Light enough for black numbers."""


def confusion(policy: str, found: Confusion) -> Figure:
    """Episodes by true task (rows) and inferred task (columns), coloured by their share of the row."""
    from matplotlib.colors import to_rgb

    colours = [
        [_mixed(to_rgb(RIGHT if task == inferred else WRONG), count / (sum(counts) or 1)) for inferred, count in line]
        for task, counts in zip(found.true, found.counts, strict=True)
        for line in [list(zip(found.inferred, counts, strict=True))]
    ]
    figure, panels = new_figure(0.17 * len(found.true) + 1.25)
    panel = panels[0, 0]
    panel.imshow(colours, aspect="auto", interpolation="nearest")
    for y, counts in enumerate(found.counts):
        for x, count in enumerate(counts):
            panel.text(x, y, formatting.count(count) if count else "", ha="center", va="center", fontsize=6)
    panel.set_yticks(range(len(found.true)), map(formatting.short_task, found.true))
    panel.set_xticks(range(len(found.inferred)), map(formatting.short_task, found.inferred), rotation=90)
    panel.set_ylabel("true task")
    panel.set_xlabel("inferred task")
    panel.tick_params(length=0, labelsize=6)
    panel.spines[:].set_visible(False)
    panel.set_title(f"{policy}: episodes", loc="left", fontweight="bold")
    return figure


def _mixed(colour: tuple[float, float, float], share: float) -> tuple[float, ...]:
    return tuple(1 - share * (1 - part) for part in colour)


def reliability(policy: str, found: Calibration, place: int) -> Figure:
    """Accuracy with 95 % intervals by the probability of the choice; on the diagonal they agree."""
    figure, panels = new_figure(2.6)
    panel, colour = panels[0, 0], COLOURS[place % len(COLOURS)]
    panel.plot((0, 100), (0, 100), "--", color="#8a949c", linewidth=0.6, zorder=1)
    for one in found.bins:
        x, ends = 100 * one.confidence, one.accuracy.interval
        if ends is not None:
            panel.vlines(x, 100 * ends.low, 100 * ends.high, colors=colour, zorder=3)
        if one.accuracy.rate is not None:
            panel.plot(x, 100 * one.accuracy.rate, "o", color=colour, markersize=3.5, zorder=4, clip_on=False)
    panel.set_xlim(0, 100)
    panel.set_ylim(0, 100)
    panel.set_xticks(range(0, 101, 25))
    panel.set_yticks(range(0, 101, 25))
    panel.grid(**GRID)
    panel.set_xlabel("probability of the choice (%)")
    panel.set_ylabel("accuracy (%), 95 % interval")
    panel.set_title(f"{policy}: calibration error {found.expected_error:.3f}", loc="left", fontweight="bold")
    return figure
