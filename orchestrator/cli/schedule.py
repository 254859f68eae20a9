"""`robogauntlet schedule`: run the suites of a file at their times."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import HistoryUrl, fail, open_history, out, print_line, runs_root
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.orchestrator.cli.serve.dashboard import PublicUrl, public_address
from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.schedules.notifications import Message, send_all, targets
from robogauntlet.orchestrator.schedules.runner import Runner
from robogauntlet.orchestrator.schedules.schedule import Schedule, read_schedules
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.orchestrator.schedules.units import Target, render_all
from robogauntlet.results.report.formatting import TextTable
from robogauntlet.results.report.history_tables import when
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput

app = typer.Typer(no_args_is_help=True)
File = Annotated[Path, typer.Argument(help="YAML file of schedules.", metavar="FILE", show_default=True)]
DEFAULT = Path("schedules.yaml")


@app.command("list")
def list_schedules(
    file: File = DEFAULT,
    test_message: Annotated[
        bool, typer.Option("--test-message", help="Only send a test notification to all recipients.")
    ] = False,
) -> None:
    """Check a file of schedules, and list when each is due.

    Their suites are checked, too.
    """
    if test_message:
        _send_test_message()
        return
    rows = []
    for one in _checked(file):
        times = f"{one.cron} {one.timezone}"
        rows.append((one.name, one.suite, " ".join(one.arguments), times, f"{when(one.next_due(time.time()))} UTC"))
    out.print(rich_table(TextTable(("name", "suite", "arguments", "when", "next"), tuple(rows), 5), title=str(file)))


@app.command("print")
def print_units(
    target: Annotated[
        Target, typer.Argument(help="Units of systemd, lines of cron, or the schedule server as a service of systemd.")
    ],
    file: File = DEFAULT,
) -> None:
    """Print the schedules for systemd or cron, which then start the runs."""
    text = render_all(_checked(file), file.resolve(), target, Path.cwd())
    out.print(text, markup=False, soft_wrap=True, end="")


@app.command()
def run(
    name: Annotated[str, typer.Argument(help="Name of a schedule.")],
    file: File = DEFAULT,
    public_url: PublicUrl = None,
    url: HistoryUrl = None,
) -> None:
    """Run a schedule now, compare it and send messages. Exit code 1 after a regression or a run that failed."""
    schedules = {one.name: one for one in _checked(file)}
    if name not in schedules:
        raise BadInput(f"{file}: no schedule '{name}'{did_you_mean(name, schedules)}")
    with _runner(public_url, url) as runner:
        outcome = runner.play(schedules[name])
    if not outcome.is_good:
        raise typer.Exit(1)


@app.command()
def serve(file: File = DEFAULT, public_url: PublicUrl = None, url: HistoryUrl = None) -> None:
    """Run the schedules of a file when they are due, until stopped."""
    schedules = _checked(file)
    with _runner(public_url, url) as runner:
        named = ", ".join(target.name for target in targets(os.environ)) or "this log only"
        _log(f"serving {', '.join(one.name for one in schedules)}; notifications go to {named}")
        runner.serve(schedules)


def _checked(file: Path) -> list[Schedule]:
    """The schedules of a file, whose suites can be planned. Raises BadInput, SuiteError."""
    schedules = read_schedules(file)
    if not schedules:
        raise BadInput(f"{file}: expected a schedule, such as `nightly: {{suite: smoke, cron: '0 2 * * *'}}`")
    for schedule in schedules:
        make_plan(find_suite(schedule.suite))
    return schedules


def _send_test_message() -> None:
    """Send a test notification to all recipients; raises BadInput if one does not get it."""
    recipients = targets(os.environ)
    if not recipients:
        variables = "ROBOGAUNTLET_WEBHOOK_URL, or the variables for e-mail (docs/operating.md)"
        raise BadInput(f"no recipient: set {variables}")
    message = Message("RoboGauntlet: a test", ("If you read this, notifications arrive.",), "none")
    if problems := send_all(message, recipients):
        raise BadInput("\n".join(problems))
    out.print("sent")


@contextmanager
def _runner(public_url: str | None, url: str | None) -> Iterator[Runner]:
    recipients, public, root = targets(os.environ), public_address(public_url), runs_root(url).absolute()

    def send(message: Message) -> None:
        _log(message.title)
        for problem in send_all(message, recipients):
            fail(problem)

    root.mkdir(parents=True, exist_ok=True)
    with open_history(url) as history, closing(ScheduleStore.open(history.url)) as store:
        yield Runner(store, history, root, send, _log, public)


def _log(line: str) -> None:
    print_line(f"{datetime.now():%Y-%m-%d %H:%M:%S}  {line}")
