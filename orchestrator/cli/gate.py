"""`robogauntlet gate`: check a run for regressions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from robogauntlet.orchestrator.cli import compare
from robogauntlet.orchestrator.cli.common import HistoryUrl, NewestRunArgument, StoreUrl, newest_run, open_history
from robogauntlet.orchestrator.runs.regression_check import check_regression
from robogauntlet.results.analysis.comparison import Comparison
from robogauntlet.results.run_document import read_run, refuse_imported
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.support.errors import BadInput


def gate(
    run: NewestRunArgument = None,
    baseline: Annotated[
        Path | None,
        typer.Option(help="Run folder to compare it with; by default the last good run of its suite before it."),
    ] = None,
    policy: compare.Only = None,
    allow: compare.Allow = None,
    alpha: compare.Alpha = None,
    margin: compare.Margin = None,
    form: compare.OutputFormat = compare.Format.TEXT,
    file: compare.OutFile = None,
    store: StoreUrl = None,
    url: HistoryUrl = None,
) -> None:
    """Check a run for regressions against its baseline run.

    Prints the verdict and the reasons. Exit codes: 0 no regression, 1 a regression, 2 not comparable.
    """
    compare.check_output(file)
    run = run or newest_run()
    if baseline is None and store is not None:
        raise BadInput(f"{run}: with --store, name the run to compare it with: --baseline RUN")
    options = {"only": policy or [], "allowed": frozenset(allow or []), "alpha": alpha, "margin": margin}
    if baseline is not None:
        refuse_imported(baseline, read_run(baseline), "a baseline")
        comparison = compare.compare_folders(run, baseline, store, options)
    else:
        comparison = _compare_with_last_good(run, url, options)
    compare.conclude(comparison, form, file, tables=False)


def _compare_with_last_good(run: Path, url: str | None, options: dict[str, Any]) -> Comparison:
    """Compare the run with the last good one of its suite, and record the verdict in the history."""
    document = read_run(run)
    compare.check_policies(run, document, options["only"])
    with open_history(url, run.absolute().parent if url is None else None) as history:
        if history.find(document.run_id) is None:
            record_run_folder(history, run, document)
        comparison = check_regression(history, document, run, **options)
    if comparison is None:
        raise BadInput(
            f"{run}: expected a complete earlier run of suite '{document.suite.name}' beside it, found none "
            f"that counts success {document.suite.success_rule}; name one with --baseline"
        )
    return comparison
