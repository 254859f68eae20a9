"""`robogauntlet schedule`: run suites at given times."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import (
    HistoryUrl,
    SuiteArgument,
    fail,
    open_history,
    out,
    print_line,
    runs_root,
)
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.orchestrator.cli.serve import PublicUrl, public_address
from robogauntlet.orchestrator.notifications import Message, Notifier, notifiers, send_all
from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.schedules.export import Target, render_all
from robogauntlet.orchestrator.schedules.schedule import CatchUp, Schedule, State, checked
from robogauntlet.orchestrator.schedules.server import AlreadyRunning, Server, exclusive_server, why_unserved
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.report.formatting import NOTHING, TextTable
from robogauntlet.results.report.history_plot import when
from robogauntlet.results.store.run_history import History
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.selection import SuiteSelection
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import counted

app = typer.Typer(no_args_is_help=True)
ScheduleName = Annotated[str, typer.Argument(help="Name of a schedule.")]


@dataclass(frozen=True)
class _Stores:
    """The open stores of schedules and runs, and the folder of the run folders."""

    schedules: ScheduleStore
    history: History
    root: Path

    def find(self, name: str) -> Schedule:
        schedule = self.schedules.find(name)
        if schedule is None:
            known = [schedule.name for schedule in self.schedules.schedules()]
            raise BadInput(f"no schedule '{name}'{did_you_mean(name, known)}")
        return schedule

    def server(self, recipients: list[Notifier], public_url: str | None, max_parallel: int = 1) -> Server:
        public = public_address(public_url)

        def send(message: Message) -> None:
            _log(message.title)
            for problem in send_all(message, recipients):
                fail(problem)

        places = self.schedules, self.history, self.root
        return Server(*places, send=send, log=_log, max_parallel=max_parallel, public=public)


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="Name of the schedule; its run folders begin with it.")],
    suite: SuiteArgument,
    cron: Annotated[str, typer.Option(help="Times: minute, hour, day of month, month, day of week; or @daily.")],
    timezone: Annotated[str, typer.Option(help="Time zone of the cron expression, such as Europe/Berlin.")] = "UTC",
    policy: Annotated[list[str] | None, typer.Option("--policy", help="Only this policy. Repeatable.")] = None,
    task: Annotated[list[str] | None, typer.Option("--task", help="Only this task. Repeatable.")] = None,
    seeds: Annotated[int | None, typer.Option("--seeds", min=1, help="Only the first N seeds.")] = None,
    media: Annotated[bool, typer.Option(help="Record videos of successes and failures.")] = True,
    catch_up: Annotated[
        CatchUp, typer.Option(help="Missed runs that are run later: the latest, all, or none (skip).")
    ] = CatchUp.LATEST,
    keep: Annotated[int | None, typer.Option(min=1, help="Number of run folders to keep; by default all.")] = None,
    gate: Annotated[bool, typer.Option(help="Check each run for regressions against its baseline run.")] = True,
    url: HistoryUrl = None,
) -> None:
    """Add a schedule. Its runs are started by `robogauntlet schedule serve`."""
    path = Path(suite)
    suite = str(path.resolve()) if path.suffix in (".yaml", ".yml") or path.exists() else suite
    plan = make_plan(find_suite(suite), part=SuiteSelection(tuple(policy or ()), tuple(task or ()), seeds))
    arguments = [*(f"--policy={pattern}" for pattern in policy or ()), *(f"--task={pattern}" for pattern in task or ())]
    arguments += [f"--seeds={seeds}"] if seeds else []
    arguments += [] if media else ["--no-media"]
    schedule = Schedule(name, suite, cron, timezone, tuple(arguments), catch_up, keep, gate, created_at=time.time())
    checked(schedule)
    with _open_stores(url) as stores:
        stores.schedules.add(schedule)
    print_line(f"{name}: {counted(plan.episodes, 'episode')} of {plan.suite.name}, next at {_next_time(schedule)}")


@app.command("list")
def list_schedules(
    target: Annotated[
        Target | None,
        typer.Option(
            "--print",
            help="Print the schedules for systemd, cron or GitHub Actions; service: the servers for systemd.",
        ),
    ] = None,
    name: Annotated[str | None, typer.Option("--name", help="Only this schedule.")] = None,
    url: HistoryUrl = None,
) -> None:
    """List schedules with their next time and the outcome of the last run."""
    with _open_stores(url) as stores:
        schedules = [stores.find(name)] if name else stores.schedules.schedules()
        last_runs = [stores.schedules.scheduled_runs(schedule=schedule.name, limit=1) for schedule in schedules]
        unserved = why_unserved(stores.schedules, stores.root, time.time())
    if target is not None:
        out.print(render_all(schedules, target, Path.cwd()), markup=False, soft_wrap=True, end="")
        return
    if not schedules:
        print_line("no schedule yet; add one: robogauntlet schedule add nightly SUITE --cron '0 2 * * *'")
        return
    rows = []
    for schedule, last in zip(schedules, last_runs, strict=True):
        state = ": ".join(filter(None, (last[0].state, last[0].outcome))) if last else NOTHING
        times = f"{schedule.cron} {schedule.timezone}"
        rows.append((schedule.name, schedule.suite, times, _next_time(schedule), state))
    out.print(rich_table(TextTable(("name", "suite", "when", "next", "last"), tuple(rows), 5), title="schedules"))
    if unserved is not None:
        fail(unserved)


@app.command()
def remove(name: ScheduleName, url: HistoryUrl = None) -> None:
    """Remove a schedule. Its runs stay."""
    with _open_stores(url) as stores:
        stores.find(name)
        stores.schedules.remove(name)
    print_line(f"{name}: removed, its runs stay")


@app.command("run-now")
def run_now(name: ScheduleName, public_url: PublicUrl = None, url: HistoryUrl = None) -> None:
    """Run a schedule now, as if it were due. Exit code 1 after a regression or a run that failed.

    If another process runs a schedule now, that one runs this one afterwards.
    """
    with _open_stores(url) as stores:
        schedule = stores.find(name)
        server = stores.server(notifiers(os.environ), public_url)
        # Recorded first: a process that serves sees it before it ends.
        run = stores.schedules.trigger_now(schedule, time.time(), server.folder)
        try:
            with exclusive_server(stores.schedules.database, stores.root):
                print_line(f"{name}: into {run.folder}")
                while waiting := [one for one in stores.schedules.scheduled_runs(state=State.DUE) if one.manual]:
                    one = run if run in waiting else waiting[-1]
                    server.play(stores.find(one.schedule), one)
                played = stores.schedules.scheduled_runs(schedule=name)
                run = next((one for one in played if one.due_at == run.due_at), run)
        except AlreadyRunning:
            print_line(f"{name}: the running schedule server starts it, into {run.folder}")
            return
        entry = stores.history.find(run.run_id or "")
    print_line(f"{name}: {run.state}, {run.outcome}")
    if run.state is not State.DONE or (entry is not None and entry.verdict == "regressed"):
        raise typer.Exit(1)


@app.command()
def serve(
    max_parallel: Annotated[
        int, typer.Option("--at-once", min=1, help="Largest number of simultaneous runs; never two of the same suite.")
    ] = 1,
    public_url: PublicUrl = None,
    url: HistoryUrl = None,
) -> None:
    """Start runs when they are due, until stopped. After a restart, runs are continued."""
    recipients = notifiers(os.environ)
    with _open_stores(url) as stores, exclusive_server(stores.schedules.database, stores.root):
        names = ", ".join(schedule.name for schedule in stores.schedules.schedules()) or "no schedule yet"
        server = stores.server(recipients, public_url, max_parallel)
        targets = ", ".join(notifier.name for notifier in recipients) or "this log only"
        _log(f"serving {names}; notifications go to {targets}")
        server.serve()


@app.command("test-message")
def test_message() -> None:
    """Send a test notification to all recipients."""
    recipients = notifiers(os.environ)
    if not recipients:
        variables = "ROBOGAUNTLET_WEBHOOK_URL, or the variables for e-mail (docs/notifications.md)"
        raise BadInput(f"no recipient: set {variables}")
    message = Message("RoboGauntlet: a test", ("If you read this, notifications arrive.",), "none")
    if problems := send_all(message, recipients):
        raise BadInput("\n".join(problems))
    out.print("sent")


@contextmanager
def _open_stores(url: str | None) -> Iterator[_Stores]:
    with open_history(url) as history, closing(ScheduleStore.open(history.url)) as schedules:
        yield _Stores(schedules, history, runs_root(url).absolute())


def _log(line: str) -> None:
    print_line(f"{datetime.now():%Y-%m-%d %H:%M:%S}  {line}")


def _next_time(schedule: Schedule) -> str:
    return f"{when(schedule.next_due(time.time()))} UTC"
