"""The contents of a report, and what a section of it is.

A section is one file: it says which columns of the rows it reads, builds its data from them once, and returns the
blocks that show these. Sections of this package are in `sections/`; other distributions add theirs by entry points of
the group `robogauntlet.sections`, each of which names a `Section`:

    SECTION = Section(
        name="length",
        title="How long it takes",
        columns=("steps",),
        build=lambda source: int(source.rows["steps"].max()),
        type=int,
        blocks=lambda longest, page: [Paragraph(f"The longest episode has {longest} control steps.")],
    )
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robogauntlet.results.analysis.tables import Tables
from robogauntlet.results.report.blocks import Block
from robogauntlet.results.report.formatting import TextTable
from robogauntlet.results.report.media import Media
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store.episodes_parquet import EPISODES_FILE
from robogauntlet.suites.episode import Condition

if TYPE_CHECKING:
    import pandas as pd

GROUP = "robogauntlet.sections"
BEFORE = (
    "in_short",
    "combinations",
    "rates",
    "robots",
    "failures",
    "behaviour",
    "pairwise",
    "robustness",
    "latency",
    "benchmark",
    "routing",
)
AFTER = ("gallery", "counts", "worker_time", "gaps", "provenance")
"""Modules of `sections/` in the order of the report; those of other distributions come between the two."""


@dataclass(frozen=True, slots=True)
class ReportPaths:
    """The files of a report, in the run folder."""

    html: Path
    """The page with images and videos inside."""
    markdown: Path
    """The same numbers as text."""
    summary: Path
    """The same numbers for programs, as JSON: see `summary_model`."""
    episodes: Path
    """All rows, Parquet."""
    cells: Path
    """A line per policy, task and condition, CSV."""

    @classmethod
    def in_folder(cls, folder: Path) -> ReportPaths:
        """Return the paths of the report of a run folder."""
        names = ("report.html", "report.md", "summary.json", EPISODES_FILE, "cells.csv")
        return cls(*(folder / name for name in names))


@dataclass(frozen=True, slots=True)
class Report:
    """The contents of all files of a report."""

    paths: ReportPaths
    document: RunDocument
    tables: Tables
    data: Mapping[str, Any]
    """Data of the sections by their names; those that the run has nothing for are left out."""

    @property
    def shown(self) -> Condition:
        """The condition of plots that have one: clean, or the first of the plan."""
        return self.tables.conditions[0] if self.tables.conditions else Condition()


@dataclass(frozen=True, slots=True)
class Source:
    """What a section builds its data from."""

    folder: Path
    document: RunDocument
    tables: Tables
    rows: pd.DataFrame
    """The rows of the run with the columns of the section, texts with few values as categories."""
    data: Mapping[str, Any]
    """Data of the sections before this one."""


@dataclass(frozen=True, slots=True)
class Page:
    """What a section can show beside its data."""

    folder: Path
    """The run folder."""
    report: Report
    media: Media


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the report."""

    name: str
    """Its key in `summary.json`, and its anchor on the page."""
    title: str
    """Its heading, and its link in the list of contents."""
    blocks: Callable[[Any, Page], Iterable[Block]]
    """What it shows, given its data and the page; without blocks, it is left out."""
    build: Callable[[Source], Any] = lambda source: None
    """Its data; None if the run has nothing for it."""
    columns: tuple[str, ...] = ()
    """Fields of the record that `build` reads."""
    applies: Callable[[RunDocument], bool] = lambda document: True
    """Whether a run can have data for it; if not, its columns are not read."""
    type: Any = None
    """Type of its data in `summary.json`; None for a section that only shows the tables of the run."""
    sentences: Callable[[Any], Iterable[str]] = lambda data: ()
    """Findings for the terminal."""
    text_tables: Callable[[Any, Report], Iterable[tuple[str, TextTable]]] = lambda data, report: ()
    """Tables for the terminal, with their titles."""
    links: Callable[[Any], Iterable[tuple[str, str]]] = lambda data: ()
    """Anchors and texts of further links in the list of contents."""


@cache
def load_sections() -> tuple[Section, ...]:
    """Return all sections in the order of the report."""
    others = [entry.load() for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name)]
    before, after = (
        [section for name in names for section in import_module(f"{__package__}.sections.{name}").SECTIONS]
        for names in (BEFORE, AFTER)
    )
    return (*before, *others, *after)
