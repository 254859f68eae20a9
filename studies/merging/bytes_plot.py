"""The plot of storage per task against a measure: a line for each way of storing experts, from many bits to few."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes

from robogauntlet.results.report.figure_style import COLOURS, GRID, STYLE, new_figure

NOT_MERGED, SHARED, NOTHING_SHARED, MERGED = (
    "not merged",
    "signs, shared magnitudes",
    "signs, nothing shared",
    "merged task vectors",
)
KINDS = (NOT_MERGED, SHARED, NOTHING_SHARED, MERGED)


TICKS = (200, 300, 500, 1000, 1500, 2000, 3000, 4000)
WIDTH, HEIGHT = 0.0075, 0.024
"""Size of a letter, as shares of the panel's."""
GAP, LOWER = 0.01, 12
"""Between a point and its name, as a share of the panel's width, and the half lines that a name may be lower."""


@dataclass(frozen=True)
class Point:
    """One way of merging."""

    name: str
    kind: str
    """One of `KINDS`."""
    kilobytes: float
    value: float
    interval: tuple[float, float] | None = None
    way: str = ""
    """Points of one way are joined."""


def draw(points: Sequence[Point], path: Path, *, measure: str, joint: float, top: float) -> None:
    """Draw the points, and joint training as a line.

    Args:
        points: All ways.
        path: The SVG file to write.
        measure: Label of the vertical axis.
        joint: The measure of one network that was trained on all tasks.
        top: End of the vertical axis, which begins at 0.
    """
    import matplotlib as mpl
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    with mpl.rc_context(STYLE):
        figure, panels = new_figure(4.4)
        figure.set_figwidth(6.7)
        panel = panels[0, 0]
        for colour, kind in zip(COLOURS, KINDS, strict=False):
            shown = [point for point in points if point.kind == kind]
            for place, way in enumerate(dict.fromkeys(point.way for point in shown)):
                own = sorted((point for point in shown if point.way == way), key=lambda point: point.kilobytes)
                x, y = [point.kilobytes for point in own], [point.value for point in own]
                label = None if place else kind
                panel.plot(x, y, "o-", color=colour, markersize=3, linewidth=0.7, label=label)
            for point in shown:
                if point.interval:
                    panel.vlines(point.kilobytes, *point.interval, colors=colour, linewidth=0.4)
        panel.axhline(joint, color="#56748c", linestyle="--", linewidth=0.8, label="joint training, one network")
        panel.set_xscale("log")
        panel.set_xlim(min(point.kilobytes for point in points) / 1.2, max(point.kilobytes for point in points) * 1.5)
        panel.set_ylim(0, top)
        panel.xaxis.set_major_locator(FixedLocator(TICKS))
        panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        panel.xaxis.set_minor_locator(NullLocator())
        _label(panel, points)
        panel.set_xlabel("kB per task beside the base, of nine tasks")
        panel.set_ylabel(measure)
        panel.grid(**GRID)
        panel.legend(frameon=False)
        figure.savefig(path, metadata={"Date": None})


def _label(panel: Axes, points: Sequence[Point]) -> None:
    """Name the points, lower where there is no room, or not: those that are not merged first, then by their values."""
    to_axes = panel.transData + panel.transAxes.inverted()
    marks = [to_axes.transform((point.kilobytes, point.value)) for point in points]
    taken = [(x - WIDTH, x + WIDTH, y) for x, y in marks]
    for point in sorted(
        (point for point in points if point.name), key=lambda point: (KINDS.index(point.kind), -point.value)
    ):
        left, middle = to_axes.transform((point.kilobytes, point.value))
        below = point.kind == NOT_MERGED
        left, right, middle = left + GAP, left + GAP + WIDTH * len(point.name), middle - (HEIGHT if below else 0)
        for lower in range(LOWER):
            place = middle - lower * HEIGHT / 2
            if all(right < start or left > end or abs(place - other) > HEIGHT for start, end, other in taken):
                taken.append((left, right, place))
                colour = COLOURS[KINDS.index(point.kind)]
                here = panel.transAxes
                panel.text(left, place, point.name, color=colour, transform=here, va="center", fontsize=5.5)
                break
