"""Writes the files of a report."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from robogauntlet.results.analysis import tables
from robogauntlet.results.analysis.tables import build_tables
from robogauntlet.results.report.markdown import render_markdown
from robogauntlet.results.report.media import VIDEO_BUDGET, collect_media
from robogauntlet.results.report.page import Chapter, render_page
from robogauntlet.results.report.parquet import read_frame
from robogauntlet.results.report.section import Page, Report, ReportPaths, Source, load_sections
from robogauntlet.results.report.summary import build_summary, render_csv
from robogauntlet.results.run_document import read_run
from robogauntlet.results.run_owner import is_own
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.episodes_parquet import write_parquet
from robogauntlet.support.files import replacing, write_whole


def write_report(folder: Path, *, store_url: str | None = None, video_budget: int = VIDEO_BUDGET) -> Report:
    """Write the report of a run, complete or not, into its folder.

    Rows are read from the store once, into `episodes.parquet`, and from there once for all sections, so that all files
    agree even while the run continues. Each file is replaced atomically.

    Args:
        folder: The run folder.
        store_url: URL of the store, if it is not the file in the folder.
        video_budget: Bytes of video in the page; other videos are named there.

    Raises:
        RunError: The folder is no run folder, or its rows are in a database whose URL was not given.
        StoreError: The store cannot be read.
        OSError: A file cannot be written.
    """
    document = read_run(folder)
    if not is_own(folder, document):  # nobody is told to paste a command of others
        document = document.model_copy(update={"command": None})
    paths = ReportPaths.in_folder(folder)
    sections = [section for section in load_sections() if section.applies(document)]
    columns = dict.fromkeys([*tables.COLUMNS, *(name for section in sections for name in section.columns)])
    with replacing(paths.episodes, shared=True) as file:
        with closing(Store.open_begun(folder, document, store_url)) as store:
            write_parquet(file, document, store)
        rows = read_frame(file, tuple(columns))
    found = build_tables(document, rows)
    media = collect_media(folder, document, rows[list(tables.COLUMNS)], video_budget)
    data: dict[str, Any] = {}
    for section in sections:
        built = section.build(Source(folder, document, found, rows[list(section.columns)], data))
        if built is not None:
            data[section.name] = built
    report = Report(paths, document, found, data)
    del rows
    chapters = show(report, Page(folder, report, media))
    write_whole(paths.summary, build_summary(report).model_dump_json(indent=1) + "\n")
    write_whole(paths.cells, render_csv(found))
    write_whole(paths.markdown, render_markdown(report, chapters))
    write_whole(paths.html, render_page(report, chapters))
    return report


def show(report: Report, page: Page) -> Sequence[Chapter]:
    """The sections that have something to show, with their blocks."""
    chapters = []
    for section in load_sections():
        data = report.data.get(section.name)
        blocks = tuple(section.blocks(data, page)) if data is not None or section.type is None else ()
        if blocks:
            chapters.append(Chapter(section, blocks, tuple(section.links(data))))
    return chapters
