"""What a section of a report is made of. Each block is described once and drawn by every renderer that shows it.

`page.py` draws blocks as HTML and SVG, `markdown.py` as GitHub Markdown. Markdown has no plots: there a plot shows its
`table`, if it has one. Positions on plots are percentages of their width or height.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import TypeAlias

from robogauntlet.results.analysis.tables import Aggregate, ErrorGroup, Tally
from robogauntlet.results.report.formatting import TextTable
from robogauntlet.results.report.media import Strip, Video


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading inside a section."""

    text: str
    policy: str | None = None
    """The policy whose marker stands before it."""
    level: int = 3
    anchor: str | None = None
    """Its id on the page, for links."""


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A sentence or several."""

    text: str
    is_note: bool = False
    """Whether it is set smaller."""
    is_of_plot: bool = False
    """Whether it explains a plot, which Markdown does not have."""


@dataclass(frozen=True, slots=True)
class Sentences:
    """Findings, one below the other."""

    items: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Terms:
    """Terms that a section uses, with their definitions, which the end of the report lists once."""

    definitions: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Table:
    """A table of texts."""

    content: TextTable
    caption: str


@dataclass(frozen=True, slots=True)
class Facts:
    """Names with their values."""

    items: tuple[tuple[str, str], ...]
    names: tuple[str, str] = ("what", "value")
    are_short: bool = False
    """Whether several fit on a line."""


@dataclass(frozen=True, slots=True)
class Code:
    """A file's text, on the page only."""

    text: str


@dataclass(frozen=True, slots=True)
class Command:
    """A command line to copy, on the page only, and what it does."""

    text: str
    command: str


@dataclass(frozen=True, slots=True)
class Legend:
    """Policies with their colours and markers; or, with `kind`, the parts of stacked bars."""

    names: tuple[str, ...]
    kind: str | None = None
    """Class of the colours, `outcome` or `phase`."""


@dataclass(frozen=True, slots=True)
class Fold:
    """Blocks that the page shows when its summary is clicked."""

    summary: str
    blocks: tuple[Block, ...]
    is_open: bool = False
    title: str | None = None
    """What stands above the blocks in Markdown, which folds nothing; None for the summary as a heading."""


@dataclass(frozen=True, slots=True)
class Rates:
    """Success rates of policies in simulators, each with its interval as a plot."""

    simulators: tuple[str, ...]
    rows: tuple[tuple[Aggregate, tuple[Aggregate | None, ...]], ...]
    """Per policy the rate over all simulators, then one per simulator."""
    table: TextTable


@dataclass(frozen=True, slots=True)
class RateGroup:
    """The rates of one task."""

    name: str
    rows: tuple[tuple[str, Tally], ...]
    """Policy and its tally."""


@dataclass(frozen=True, slots=True)
class RatePlot:
    """A forest plot of success rates."""

    title: str
    groups: tuple[RateGroup, ...]
    """Empty if no episode has a result."""
    table: TextTable | None = None
    figure: str = ""
    """Name of its file among the figures for papers, which other plots of the section share; empty: none."""


@dataclass(frozen=True, slots=True)
class ForestRow:
    """A difference on a forest plot; positions are percentages of the plot's width, from the left."""

    name: str
    value: str
    """The difference and its interval, as text."""
    low: float
    at: float
    high: float
    is_pooled: bool
    """Whether the row is of several tasks."""
    is_shown: bool
    """Whether the adjusted p-value is significant."""


@dataclass(frozen=True, slots=True)
class ForestGroup:
    """Rows under one heading."""

    name: str
    rows: tuple[ForestRow, ...]


@dataclass(frozen=True, slots=True)
class Forest:
    """A forest plot of differences of success rates."""

    title: str
    note: str
    ticks: tuple[str, ...]
    """Five labels, evenly spaced from the left end to the right."""
    margin: float | None
    """Position of the non-inferiority margin."""
    groups: tuple[ForestGroup, ...]
    about: str = ""
    """The policies of a plot of two."""


@dataclass(frozen=True, slots=True)
class Point:
    """An estimate on a plot; without an interval `low` and `high` are None."""

    x: float
    y: float
    low: float | None
    high: float | None
    text: str
    """Shown by the pointer."""


@dataclass(frozen=True, slots=True)
class Line:
    """The points of one policy, from left to right."""

    policy: str
    points: tuple[Point, ...]


@dataclass(frozen=True, slots=True)
class LineChart:
    """Rates over a number. `y` and intervals are percentages of the height, from the bottom."""

    title: str
    label: str
    lines: tuple[Line, ...]
    ticks: tuple[tuple[float, str], ...]
    """Places and labels of the axis below."""
    x_label: str
    y_label: str
    has_diagonal: bool = False
    """Whether agreement of both axes is drawn, and points with intervals instead of lines with bands."""
    figure: str = ""
    about: str = ""
    """Policies in the name of the figure's file, if it is one of several."""


@dataclass(frozen=True, slots=True)
class Mark:
    """An estimate in a row of an `IntervalPlot`."""

    at: float
    interval: tuple[float, float] | None
    wide: tuple[float, float] | None
    """Ends of the thin line: an interval that is corrected for the number of rows."""
    text: str


@dataclass(frozen=True, slots=True)
class IntervalPlot:
    """Estimates with intervals, row by row, of one policy."""

    title: str
    policy: str
    label: str
    rows: tuple[tuple[str, Mark], ...]
    ticks: tuple[tuple[float, str], ...]
    x_label: str
    figure: str


@dataclass(frozen=True, slots=True)
class HeatCell:
    """A cell of a heat map."""

    share: float
    """Depth of the colour, from 0 to 1."""
    text: str
    note: str = ""
    title: str = ""
    kind: str = "right"
    """`right`, `wrong`, or `nothing` where nothing was played."""


@dataclass(frozen=True, slots=True)
class HeatMap:
    """A table whose cells have colours."""

    label: str
    corner: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[HeatCell, ...]], ...]
    groups: tuple[tuple[str, int, str | None], ...] = ()
    """Headings above the columns: text, number of columns, and the policy whose marker stands before it."""
    title: str = ""
    table: TextTable | None = None
    figure: str = ""
    about: str = ""
    unit: str = "success (%)"

    @property
    def starts(self) -> frozenset[int]:
        """Places of the columns with which groups start."""
        return frozenset(accumulate((columns for _, columns, _ in self.groups), initial=0))


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of a bar."""

    name: str
    start: float
    width: float
    text: str
    """`dropped: 6 of 30 episodes`."""


@dataclass(frozen=True, slots=True)
class Bar:
    """A whole and its parts."""

    name: str
    value: str
    segments: tuple[Segment, ...]
    label: str


@dataclass(frozen=True, slots=True)
class StackedBars:
    """Wholes and their parts, `kind` being the class of the colours."""

    kind: str
    bars: tuple[Bar, ...]
    figure: str = ""


@dataclass(frozen=True, slots=True)
class Charts:
    """Plots side by side."""

    items: tuple[LineChart | IntervalPlot | HeatMap, ...]


@dataclass(frozen=True, slots=True)
class Videos:
    """Videos with captions, on the page only, which has each once: where it comes again, a link leads to it."""

    items: tuple[tuple[Video, str], ...]


@dataclass(frozen=True, slots=True)
class Strips:
    """First observations of tasks, severity by severity, on the page only."""

    items: tuple[tuple[Strip, tuple[str, ...]], ...]
    """Each with the captions of its snapshots."""


@dataclass(frozen=True, slots=True)
class Card:
    """One task of the gallery."""

    task: str
    instruction: str | None
    picture: str | None
    lines: tuple[tuple[str, Tally, tuple[tuple[Video, str], ...]], ...]
    """Policy, its tally and its videos with captions: a success, a failure, both or none."""


@dataclass(frozen=True, slots=True)
class Cards:
    """Tasks with their picture and videos, on the page only."""

    items: tuple[Card, ...]


@dataclass(frozen=True, slots=True)
class Errors:
    """Messages of errors with the commands that replay them."""

    groups: tuple[ErrorGroup, ...]
    run: str
    """The run folder, quoted for a shell."""


Block: TypeAlias = (
    Heading
    | Paragraph
    | Sentences
    | Terms
    | Table
    | Facts
    | Code
    | Command
    | Legend
    | Fold
    | Rates
    | RatePlot
    | Forest
    | LineChart
    | IntervalPlot
    | HeatMap
    | StackedBars
    | Charts
    | Videos
    | Strips
    | Cards
    | Errors
)
