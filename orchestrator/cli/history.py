"""`gauntlet history`, `leaderboard` and `accept`: many runs together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.shared import BadInput, HistoryUrl, fail, open_history, out
from orchestrator.cli.tables import rich_table
from orchestrator.standings import newest_played
from results.entries import RunEntry
from results.leaderboard import leaderboard
from results.report.nights import (
    nights_table,
    sparkline,
    standings_table,
    verdict_text,
    when,
    write_plot,
)
from results.report.text import TextTable, count, percent, span
from suites.plugins import nearest


def history(
    policy: Annotated[str | None, typer.Argument(help="A policy's name; without it, runs are listed.")] = None,
    suite: Annotated[str | None, typer.Option(help="Only runs of this suite.")] = None,
    task: Annotated[str | None, typer.Option(help="Only on this task.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="The newest so many runs.")] = 30,
    file: Annotated[
        Path | None, typer.Option("--out", help="Write a plot as well: FILE.svg, or a page FILE.html.")
    ] = None,
    url: HistoryUrl = None,
) -> None:
    """How a policy did from run to run, or what was run."""
    if file is not None and policy is None:
        raise BadInput(
            "--out: expected the name of the policy whose plot is wanted: gauntlet history POLICY --out FILE"
        )
    if file is not None and file.suffix not in (".svg", ".html"):
        raise BadInput(f"--out: expected a file that ends in .svg or .html, got '{file}'")
    with open_history(url) as kept:
        if suite is not None and suite not in kept.suites():
            raise BadInput(f"no run of a suite '{suite}'{nearest(suite, kept.suites())}")
        if policy is None:
            out.print(rich_table(_runs_table(kept.runs(suite=suite, limit=limit)), title="runs, the newest first"))
            return
        nights = kept.nights(policy, suite=suite, task=task, limit=limit)
        if not nights:
            known = kept.policies(suite)
            hint = f" on '{task}'" if task and policy in known else nearest(policy, known)
            raise BadInput(f"no run with a policy '{policy}'{hint}")
    title = ", ".join(filter(None, (policy, task, suite and f"suite {suite}")))
    out.print(rich_table(nights_table(nights), title=title))
    out.print(f"\n{sparkline(nights)}  success, 0 to 100 %, the newest on the right", markup=False)
    if file is not None:
        try:
            write_plot(file, nights, f"{title}: success from run to run")
        except OSError as error:
            raise BadInput(f"{file}: cannot be written: {error.strerror}") from None
        out.print(f"plot: {file}", markup=False, soft_wrap=True)


def show_leaderboard(
    suite: Annotated[str, typer.Argument(help="Name of a suite that was run.")],
    alpha: Annotated[float, typer.Option(min=0.0001, max=0.4999, help="Family-wise error.")] = 0.05,
    url: HistoryUrl = None,
) -> None:
    """Each policy's newest run of a suite; policies that share a letter were not shown to differ."""
    with open_history(url) as kept:
        if suite not in kept.suites():
            raise BadInput(f"no run of a suite '{suite}'{nearest(suite, kept.suites())}")
        played = list(newest_played(kept, suite, fail))
    if not played:
        raise BadInput(f"expected a complete run of suite '{suite}', there is none")
    out.print(rich_table(standings_table(leaderboard(played, alpha)), title=f"{suite}, clean episodes"))
    out.print(
        f"\nPolicies that share a letter were not shown to differ (McNemar, Holm, alpha {alpha:g}).", markup=False
    )


def accept(
    run: Annotated[str, typer.Argument(help="Name of a run's folder, or the beginning of its id.")],
    url: HistoryUrl = None,
) -> None:
    """Let later runs be held against this one, although it was found worse."""
    with open_history(url) as kept:
        entry = kept.find(Path(run).name)
        if entry is None:
            raise BadInput(f"no run '{run}' in the history; see: gauntlet history")
        kept.accept(entry.run_id)
    out.print(f"{entry.name}: later runs of {entry.suite} are held against it", markup=False, soft_wrap=True)


def _runs_table(entries: Sequence[RunEntry]) -> TextTable:
    header = ("begun (UTC)", "run", "suite", "status", "verdict", "rate", "interval", "done", "planned", "errors")
    rows = tuple(
        (
            when(entry.started_at),
            entry.name,
            entry.suite,
            entry.status,
            verdict_text(entry.verdict, accepted=entry.accepted),
            percent(entry.counts.rate),
            span(entry.counts.interval),
            count(entry.counts.done),
            count(entry.counts.planned),
            count(entry.counts.errors),
        )
        for entry in entries
    )
    return TextTable(header, rows, 5)
