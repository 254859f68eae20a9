"""Writes the files of a report."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from robogauntlet.results.analysis import behaviour, combinations, failures, merging_cost, pairwise, robustness
from robogauntlet.results.analysis.comparison import Run
from robogauntlet.results.analysis.merging_cost import build_merging
from robogauntlet.results.analysis.tables import build_tables
from robogauntlet.results.report.markdown import render_markdown
from robogauntlet.results.report.media import VIDEO_BUDGET, collect_media
from robogauntlet.results.report.page import render_page
from robogauntlet.results.report.parquet import read_frame
from robogauntlet.results.report.summary import Report, ReportPaths, build_summary, render_csv
from robogauntlet.results.run_document import read_run
from robogauntlet.results.run_owner import is_own
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.episodes_parquet import write_parquet
from robogauntlet.support.files import replacing, write_whole


def write_report(folder: Path, *, store_url: str | None = None, video_budget: int = VIDEO_BUDGET) -> Report:
    """Write the report of a run, complete or not, into its folder.

    Rows are read from the store once, into `episodes.parquet`; all other files use that file, so that they agree even
    while the run continues. Each file is replaced atomically.

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
    with replacing(paths.episodes, shared=True) as file:
        with closing(Store.open_begun(folder, document, store_url)) as store:
            write_parquet(file, document, store)
        frame = read_frame(file)
    tables = build_tables(document, frame)
    media = collect_media(folder, document, frame, video_budget)
    del frame
    merging = perturbed = compared = None
    if document.suite.merging is not None:
        merging = build_merging(document, read_frame(paths.episodes, merging_cost.COLUMNS))
    if robustness.is_perturbed(document):
        perturbed = robustness.build_robustness(document, read_frame(paths.episodes, robustness.COLUMNS))
    if tables.total.done and len({cell.policy for cell in document.plan}) > 1:
        rows = read_frame(paths.episodes, pairwise.COLUMNS)
        compared = pairwise.compare_all(Run(folder.absolute().name, document, rows))
        del rows
    combined = combinations.build_combinations(document, read_frame(paths.episodes, combinations.COLUMNS))
    failed = failures.build_failures(document, read_frame(paths.episodes, failures.COLUMNS))
    moved = behaviour.build_behaviour(document, read_frame(paths.episodes, behaviour.COLUMNS))
    report = Report(paths, document, tables, merging, perturbed, compared, combined, failed, moved)
    write_whole(paths.summary, build_summary(report).model_dump_json(indent=1) + "\n")
    write_whole(paths.cells, render_csv(tables))
    write_whole(paths.markdown, render_markdown(report))
    write_whole(paths.html, render_page(folder, report, media))
    return report
