"""`robogauntlet history`: list runs, or show the success of a policy over its runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import AsJson, HistoryUrl, open_history, out, print_json, print_line
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.results.report.formatting import TextTable, count
from robogauntlet.results.report.history_plot import (
    PLOT,
    kind_history_table,
    new_kinds,
    policy_history_table,
    run_rate,
    sparkline,
    verdict_text,
    when,
    write_plot,
)
from robogauntlet.results.store.failure_history import kinds_by_run, kinds_in_run
from robogauntlet.results.store.history_records import RunEntry
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput


def history(
    policy: Annotated[str | None, typer.Argument(help="Name of a policy; without it, runs are listed.")] = None,
    suite: Annotated[str | None, typer.Option(help="Only runs of this suite.")] = None,
    task: Annotated[str | None, typer.Option(help="Only this task.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="Largest number of runs; the newest are shown.")] = 30,
    file: Annotated[Path | None, typer.Option("--out", help="Plot to write: FILE.svg, or FILE.html.")] = None,
    as_json: AsJson = False,
    url: HistoryUrl = None,
) -> None:
    """List runs, or show the success of a policy over its runs."""
    if file is not None and policy is None:
        raise BadInput("--out: expected the name of the policy to plot: robogauntlet history POLICY --out FILE")
    if file is not None and file.suffix not in (".svg", ".html"):
        raise BadInput(f"--out: expected a file that ends in .svg or .html, got '{file}'")
    if file is not None:
        PLOT.check(file)
    with open_history(url) as history:
        if suite is not None and suite not in history.suites():
            raise BadInput(f"no run of a suite '{suite}'{did_you_mean(suite, history.suites())}")
        if policy is None:
            runs = history.runs(suite=suite, limit=limit)
            if as_json:
                print_json(runs)
            else:
                out.print(rich_table(_runs_table(runs), title="Runs, newest first"))
            return
        results = history.policy_history(policy, suite=suite, task=task, limit=limit)
        if not results:
            known = history.policies(suite)
            hint = f" on '{task}'" if task and policy in known else did_you_mean(policy, known)
            raise BadInput(f"no run with a policy '{policy}'{hint}")
        kinds = [] if as_json else kinds_by_run(results, lambda result: kinds_in_run(result, history.url, task))
    if as_json:
        print_json(results)
        return
    title = ", ".join(filter(None, (policy, task, suite and f"suite {suite}")))
    out.print(rich_table(policy_history_table(results), title=title))
    out.print(f"\n{sparkline(results)}  success, 0 to 100 %, newest on the right", markup=False)
    if kinds:
        out.print()
        out.print(rich_table(kind_history_table(kinds), title="Failures in clean episodes by kind"))
        for line in new_kinds(kinds):
            print_line(f"- {line}")
    if file is not None:
        write_plot(file, results, f"{title}: success from run to run")
        print_line(f"plot: {file}")


def _runs_table(entries: Sequence[RunEntry]) -> TextTable:
    header = ("begun (UTC)", "run", "suite", "status", "verdict", "success", "done", "planned", "errors")
    rows = tuple(
        (
            when(entry.started_at),
            entry.name,
            entry.suite,
            entry.status_text,
            verdict_text(entry.verdict, accepted=entry.accepted),
            run_rate(entry.counts, entry.policies),
            count(entry.counts.done),
            count(entry.counts.planned),
            count(entry.counts.errors),
        )
        for entry in entries
    )
    return TextTable(header, rows, 5)
