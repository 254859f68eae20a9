"""What all figures for papers share: their width, colours, markers and legend."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMN = 3.35
"""Width of a figure (inches): one column of a two-column paper."""
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#aa4499", "#b88700", "#56748c")
"""Colours of policies, those of report.css on white; distinguishable with colour blindness."""
PHASE_COLOURS = {
    **{"build": "#8a949c", "load": "#c3c9ce", "reset": "#cc79a7", "physics": "#0072b2", "render": "#e69f00"},
    **{"inference": "#009e73", "rest": "#56b4e9", "wait": "#e3e6e8"},
}
"""Colours of the phases of worker time, those of report.css."""
HEAT_COLOURS = {"right": "#5f9fcf", "wrong": "#eea47a", "nothing": "#e3e6e8"}
"""Of full cells of heat maps; light enough for black numbers."""
MARKERS = ("o", "s", "D", "^", "P", "v")
LINES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
STYLE = {
    **{"font.size": 7, "axes.titlesize": 7, "axes.labelsize": 7, "legend.fontsize": 6.5},
    **{"xtick.labelsize": 6.5, "ytick.labelsize": 6.5, "axes.linewidth": 0.6, "lines.linewidth": 1.1},
    **{"xtick.major.width": 0.6, "ytick.major.width": 0.6, "axes.spines.top": False, "axes.spines.right": False},
    **{"font.family": "sans-serif", "figure.dpi": 300, "savefig.dpi": 300, "svg.hashsalt": "robogauntlet"},
    **{"pdf.fonttype": 42, "axes.unicode_minus": False, "text.parse_math": False},
}
"""Sizes for print, embedded TrueType fonts, equal bytes for equal numbers, and no formulae in names."""
GRID: dict[str, Any] = {"color": "#d5dadd", "linewidth": 0.5, "zorder": 0}


def mixed(colour: str, share: float) -> tuple[float, ...]:
    """Return the colour (hexadecimal) mixed with white, `share` from 0 to 1 of it, as red, green and blue."""
    from matplotlib.colors import to_rgb

    return tuple(1 - share * (1 - part) for part in to_rgb(colour))


def new_figure(height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, Any]:
    """Return an empty figure of this height (inches) and its panels, an array of rows and columns."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(COLUMN, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def draw_legend(figure: Figure, panels: Iterable[Axes], names: Sequence[str], columns: int = 2) -> None:
    """Name what the panels draw above them, in this order."""
    handles: dict[str, Any] = {}
    for panel in panels:
        handles |= dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True))
    if len(names) < 2 or max(map(len, names)) > 28:
        columns = 1
    figure.legend(
        [handles[name] for name in names],
        names,
        loc="outside upper center",
        ncols=columns,
        frameon=False,
        handletextpad=0.5,
        columnspacing=1.2,
    )
