"""`robogauntlet list runs`: list runs, or show the success of a policy over its runs, or forget a run."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import AsJson, HistoryUrl, open_history, out, print_json, print_line, refuse
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.results.folder_lock import LOCK_FILE
from robogauntlet.results.report.formatting import TextTable, count, counted
from robogauntlet.results.report.history_tables import policy_history_table, run_rate, sparkline, verdict_text, when
from robogauntlet.results.run_document import RUN_FILE, RunError, read_run
from robogauntlet.results.store.database import without_password
from robogauntlet.results.store.history_records import RunEntry
from robogauntlet.results.store.run_history import SHORTEST_ID
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput, describe_os_error
from robogauntlet.support.files import is_held


def list_runs(
    policy: Annotated[str | None, typer.Argument(help="Name of a policy; without it, runs are listed.")] = None,
    suite: Annotated[str | None, typer.Option(help="Only runs of this suite.")] = None,
    task: Annotated[str | None, typer.Option(help="Only this task.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="Largest number of runs; the newest are shown.")] = 30,
    forget: Annotated[
        str | None,
        typer.Option(
            metavar="RUN",
            help=f"Remove this run from the list: the name of its folder, or {SHORTEST_ID} or more characters of its "
            "id. Its folder stays, and is not listed again; importing or continuing the run lists it.",
        ),
    ] = None,
    delete: Annotated[
        bool, typer.Option("--delete", help="With --forget: remove its folder and its rows, too.")
    ] = False,
    as_json: AsJson = False,
    url: HistoryUrl = None,
) -> None:
    """List runs, or show the success of a policy over its runs."""
    if forget is not None:
        refuse("--forget", {"POLICY": policy, "--suite": suite, "--task": task, "--json": as_json})
        _forget(forget, url, delete=delete)
        return
    if delete:
        raise BadInput("--delete: expected with --forget RUN")
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
    if as_json:
        print_json(results)
        return
    title = ", ".join(filter(None, (policy, task, suite and f"suite {suite}")))
    out.print(rich_table(policy_history_table(results), title=title))
    out.print(f"\n{sparkline(results)}  success, 0 to 100 %, newest on the right", markup=False)


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


def _forget(run: str, url: str | None, *, delete: bool) -> None:
    """Remove a run from the history, and its folder and rows if wanted."""
    with open_history(url) as history:
        entry = history.find(Path(run).name)
        if entry is None:
            raise BadInput(f"no run '{run}' in the history; see: robogauntlet list runs")
        here = entry.rows_url is not None and entry.rows_url == without_password(history.url)
        if here and not delete:
            raise BadInput(f"{entry.name}: expected --delete, since its rows are in the history's own database")
        folder = _folder_of(entry)
        rows = history.forget(entry.run_id, None if delete or folder is None else str(folder))
    removed = ["the history"]
    if rows:
        removed.append(f"{counted(rows, 'row')} in it")
    if delete and folder is not None:
        try:
            shutil.rmtree(folder)
        except OSError as error:
            raise BadInput(f"{folder}: forgotten, but it cannot be removed: {describe_os_error(error)}") from None
        removed.append(f"the folder {folder}")
    print_line(f"{entry.name}: removed {' and '.join(['from ' + removed[0], *removed[1:]])}")
    if folder is not None and not delete:
        print_line(f"its folder stays: {folder}")
    if entry.rows_url is not None and not here:
        print_line(f"its rows stay in {entry.rows_url}")


def _folder_of(entry: RunEntry) -> Path | None:
    """The folder of a run that has ended, or None if it is gone. Raises BadInput."""
    folder = Path(entry.folder) if entry.folder else None
    if folder is None or not (folder / RUN_FILE).exists():
        return None
    if is_held(folder / LOCK_FILE):
        raise BadInput(f"{folder}: expected a run that has ended, a process is running it; stop it first")
    with contextlib.suppress(RunError):  # a broken run can be forgotten, too
        if (found := read_run(folder).run_id) != entry.run_id:
            raise BadInput(f"{folder}: expected run {entry.run_id}, the folder has run {found}")
    return folder
