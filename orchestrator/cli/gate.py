"""`robogauntlet gate`: check a run for regressions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import (
    BadInput,
    HistoryUrl,
    NewestRunArgument,
    StoreUrl,
    newest_run,
    open_history,
    out,
)
from robogauntlet.orchestrator.cli.compare import (
    EXIT_CODES,
    Allow,
    Alpha,
    Format,
    Margin,
    Only,
    OutFile,
    OutputFormat,
    check_policies,
    compare_folders,
    write_comparison,
)
from robogauntlet.orchestrator.runs.regression_check import check_regression
from robogauntlet.results.analysis.comparison import Comparison, Difference
from robogauntlet.results.run_document import RunError, read_run
from robogauntlet.results.store.episode_store import StoreError
from robogauntlet.results.store.history_import import record_run_folder


def gate(
    run: NewestRunArgument = None,
    baseline: Annotated[
        Path | None,
        typer.Option(help="Run folder to compare it with; by default the last good run of its suite before it."),
    ] = None,
    policy: Only = None,
    allow: Allow = None,
    alpha: Alpha = None,
    margin: Margin = None,
    form: OutputFormat = Format.TEXT,
    file: OutFile = None,
    store: StoreUrl = None,
    url: HistoryUrl = None,
) -> None:
    """Check a run for regressions against its baseline run.

    Prints the verdict and the reasons. Exit codes: 0 no regression, 1 a regression, 2 not comparable.
    """
    from robogauntlet.results.report.comparison import as_text

    run = run or newest_run()
    if baseline is None and store is not None:
        raise BadInput(f"{run}: with --store, name the run to compare it with: --baseline RUN")
    if baseline is not None:
        comparison = compare_folders(run, baseline, policy or [], allow or [], alpha, margin, store)
    else:
        comparison = _compare_with_last_good(run, policy or [], allow or [], alpha, margin, url)
    if form is Format.TEXT and file is None:
        out.print(as_text(comparison), markup=False, soft_wrap=True, end="")
    else:
        write_comparison(comparison, form, file)
    raise typer.Exit(EXIT_CODES[comparison.verdict])


def _compare_with_last_good(
    run: Path,
    policies: list[str],
    allowed: list[Difference],
    alpha: float | None,
    margin: float | None,
    url: str | None,
) -> Comparison:
    """Compare the run with the last good one of its suite, and record the verdict in the history.

    Raises:
        BadInput: There is no earlier run, or one of the two cannot be read.
    """
    try:
        document = read_run(run)
        check_policies(run, document, policies)
        with open_history(url, run.absolute().parent if url is None else None) as history:
            if history.find(document.run_id) is None:
                record_run_folder(history, run, document)
            comparison = check_regression(
                history, document, run, alpha=alpha, margin=margin, only=policies, allowed=frozenset(allowed)
            )
    except (RunError, StoreError) as error:
        raise BadInput(str(error)) from None
    if comparison is None:
        raise BadInput(
            f"{run}: expected a complete earlier run of suite '{document.suite.name}' beside it, found none; "
            "name one with --baseline"
        )
    return comparison
