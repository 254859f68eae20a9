"""Writes the files of a report."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from results import merging
from results import robustness as robustness_of_run
from results.merging import Merging, build_merging
from results.report.explore import render_explorer
from results.report.markdown import render_markdown
from results.report.media import VIDEO_BUDGET, collect_media
from results.report.page import render_page
from results.report.parquet import read_frame, write_parquet
from results.report.spreadsheet import render_csv
from results.report.summary import build_summary
from results.robustness import Robustness
from results.run import RunDocument, RunError, read_run
from results.store import Store
from results.tables import Tables, build_tables


@dataclass(frozen=True, slots=True)
class ReportPaths:
    """The files of a report, in the run folder."""

    html: Path
    """For people: one file, with pictures and videos inside."""
    markdown: Path
    """The same numbers as text."""
    summary: Path
    """The same numbers for programs, see `Summary`."""
    episodes: Path
    """Every row, Parquet."""
    cells: Path
    """A line per policy, task and condition, CSV."""
    explorer: Path
    """Plots to turn over by hand, HTML with scripts; only where something was perturbed."""

    @classmethod
    def of(cls, folder: Path) -> ReportPaths:
        """Where the report of a run folder is, or will be."""
        names = ("report.html", "report.md", "summary.json", "episodes.parquet", "cells.csv", "explore.html")
        return cls(*(folder / name for name in names))


def write_report(folder: Path, *, store_url: str | None = None, video_budget: int = VIDEO_BUDGET) -> ReportPaths:
    """Write the report of a run, complete or not, into its folder.

    Rows are read from the store once, into `episodes.parquet`; everything else is made from that file, so that the
    files of a report agree even while the run goes on. Each is replaced as a whole or left as it was.

    Args:
        folder: The run folder.
        store_url: URL of the store, where it is not the file in the folder.
        video_budget: Bytes of video that are put into the page; the others are named there.

    Raises:
        RunError: The folder is no run, or its rows are in a database whose URL was not given.
        StoreError: The store cannot be read.
        OSError: A file cannot be written.
    """
    document = read_run(folder)
    paths = ReportPaths.of(folder)
    with _replacing(paths.episodes) as file:
        _write_rows(file, folder, document, store_url)
        frame = read_frame(file)
    tables = build_tables(document, frame)
    media = collect_media(folder, document, frame, video_budget)
    del frame
    compared, robustness = _compare(document, paths.episodes), _stress(document, paths.episodes)
    _write_text(paths.summary, build_summary(document, tables, compared, robustness).model_dump_json(indent=1) + "\n")
    _write_text(paths.cells, render_csv(tables))
    _write_text(paths.markdown, render_markdown(document, tables, compared, robustness))
    if robustness is not None:
        _write_text(paths.explorer, render_explorer(document, tables, robustness))
    _write_text(paths.html, render_page(folder, document, tables, media, compared, robustness))
    return paths


def read_tables(folder: Path) -> Tables:
    """The tables of a report that was written before.

    Raises:
        RunError: The folder is no run, or has no report yet.
    """
    return build_tables(read_run(folder), read_frame(_written(folder)))


def read_merging(folder: Path) -> Merging | None:
    """What merging and routing cost, from a report that was written before; None if the suite does not ask for it.

    Raises:
        RunError: The folder is no run, or has no report yet.
    """
    return _compare(read_run(folder), _written(folder))


def read_findings(folder: Path) -> tuple[str, ...]:
    """What a report that was written before found under perturbations, in sentences.

    Raises:
        RunError: The folder is no run, or has no report yet.
    """
    _written(folder)
    summary = json.loads(ReportPaths.of(folder).summary.read_text(encoding="utf-8"))
    return tuple(map(str, summary.get("findings", ())))


def _written(folder: Path) -> Path:
    read_run(folder)
    file = ReportPaths.of(folder).episodes
    if not file.exists():
        raise RunError(f"{folder}: no report yet; write it with: gauntlet report {folder}")
    return file


def _compare(document: RunDocument, file: Path) -> Merging | None:
    return None if document.merging is None else build_merging(document, read_frame(file, merging.COLUMNS))


def _stress(document: RunDocument, file: Path) -> Robustness | None:
    if not robustness_of_run.is_perturbed(document):
        return None
    return robustness_of_run.build_robustness(document, read_frame(file, robustness_of_run.COLUMNS))


def _write_rows(file: Path, folder: Path, document: RunDocument, url: str | None) -> None:
    store = Store.open_begun(folder, document, url)
    try:
        write_parquet(file, document, store)
    finally:
        store.close()


def _write_text(path: Path, text: str) -> None:
    with _replacing(path) as file:
        file.write_text(text, encoding="utf-8")


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A temporary file that takes the place of `path` when all went well."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
