"""`robogauntlet report`: write the report of a run again, or print its success table or BibTeX."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.citations import bibtex
from robogauntlet.orchestrator.cli.common import (
    RUNS,
    NewestRunArgument,
    StoreUrl,
    newest_run,
    print_line,
    print_text,
    refuse,
)
from robogauntlet.orchestrator.cli.console_tables import print_summary
from robogauntlet.results.report.figures import FOLDER, FigureFormat, check_matplotlib, write_figures
from robogauntlet.results.report.success_table import TableFormat, render_table, success_table
from robogauntlet.results.run_document import RUN_FILE
from robogauntlet.suites.conditions import condition_patterns, split_condition
from robogauntlet.suites.episode import Condition
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput


def report(
    folder: NewestRunArgument = None,
    store: StoreUrl = None,
    video_mb: Annotated[
        float | None,
        typer.Option(min=0, max=1000, help="Largest size of all videos in report.html (MB); by default 9."),
    ] = None,
    table: Annotated[
        TableFormat | None, typer.Option(help="Print the success table in this format instead; nothing is written.")
    ] = None,
    figures: Annotated[
        FigureFormat | None,
        typer.Option(help='Also write figures for a paper, in this format. Needs pip install "robogauntlet[figures]".'),
    ] = None,
    cite: Annotated[
        bool,
        typer.Option(
            "--cite",
            help="Print BibTeX of RoboGauntlet, and of the suite and the simulators of the run, instead; nothing is "
            "written.",
        ),
    ] = False,
    condition: Annotated[
        str | None,
        typer.Option(metavar="AXIS[@SEVERITY]", help="Condition of the table; by default the first of the run."),
    ] = None,
) -> None:
    """Write the report of a run again, or print its table or BibTeX.

    The report consists of report.html, report.md, summary.json, cells.csv and episodes.parquet. With --table, the
    success table is printed: tasks in rows, policies in columns. With --figures, the plots are also written as files
    into the folder figures of the run.
    """
    if cite:
        refuse("--cite", {"--table": table, "--figures": figures, "--condition": condition, "--store": store})
        print_text(bibtex(folder or (newest_run() if any(RUNS.glob(f"*/{RUN_FILE}")) else None)))
        return
    if table is not None and figures is not None:
        raise BadInput("expected --table, which writes nothing, or --figures, got both")
    if condition is not None and table is None:
        raise BadInput("--condition: expected with --table, such as --table latex --condition clean")
    folder = folder or newest_run()
    if table is not None:
        print_text(_success_table(folder, store, condition, table))
        return
    from robogauntlet.results.report import write_report

    if figures is not None:
        check_matplotlib()
    budget = {} if video_mb is None else {"video_budget": int(1e6 * video_mb)}
    try:
        written = write_report(folder, store_url=store, **budget)
        drawn = [] if figures is None else write_figures(written, folder / FOLDER, figures)
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written: {error.strerror}") from None
    print_summary(written)
    print_line(f"report: {written.paths.html}")
    for path in drawn:
        print_line(f"figure: {path}")


def _success_table(folder: Path, store: str | None, condition: str | None, form: TableFormat) -> str:
    from robogauntlet.results.api import open_run

    run = open_run(folder, store)
    tables = run.tables()
    return render_table(success_table(run.document.suite.name, tables, _find(condition, tables.conditions)), form)


def _find(wanted: str | None, conditions: Sequence[Condition]) -> Condition:
    """Return the wanted one of a run's conditions, by default the first. Raises BadInput."""
    if wanted is None:
        return conditions[0] if conditions else Condition()
    spelled = condition_patterns(wanted)
    axis, severity = split_condition(wanted)
    found = [one for one in conditions if str(one) in spelled or (severity is None and one.axis == axis)]
    if len(found) == 1:
        return found[0]
    names = [str(one) for one in found or conditions]
    if found:
        raise BadInput(f"--condition: expected one severity of {axis}, got '{wanted}'; the run has {', '.join(names)}")
    raise BadInput(f"--condition: the run has no condition '{wanted}'{did_you_mean(wanted, names)}")
