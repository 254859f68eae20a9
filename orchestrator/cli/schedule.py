"""`gauntlet schedule`: runs that begin by themselves."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from orchestrator.calendar.book import Book
from orchestrator.calendar.handing import Target, hand_over
from orchestrator.calendar.playing import Say
from orchestrator.calendar.schedule import CatchUp, Schedule, ScheduleError, State, checked
from orchestrator.calendar.serving import AlreadyServed, Server, served_alone
from orchestrator.cli.shared import BadInput, HistoryUrl, fail, open_history, out, plan_of, runs_root
from orchestrator.cli.tables import rich_table
from orchestrator.telling import Kind, Message, Teller, TellingError, tell, tellers
from results.database import StoreError
from results.history import History
from results.report.nights import when
from results.report.text import NOTHING, TextTable
from suites.part import Part
from suites.plugins import nearest

app = typer.Typer(help="Runs that begin by themselves: every night, say.", no_args_is_help=True)


@dataclass(frozen=True)
class Desk:
    """The calendar and the history, open."""

    book: Book
    history: History
    root: Path

    def schedule(self, name: str) -> Schedule:
        """The schedule of that name. Raises BadInput: there is none."""
        found = self.book.find(name)
        if found is None:
            known = [one.name for one in self.book.schedules()]
            raise BadInput(f"no schedule '{name}'{nearest(name, known)}")
        return found

    def server(self, at_once: int = 1) -> Server:
        """What begins runs."""
        return Server(self.book, self.history, self.root, say=_say(_tellers()), log=_log, at_once=at_once)


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="What to call it; its run folders begin with it.")],
    suite: Annotated[str, typer.Argument(help="A suite file, or the name of a shipped suite.")],
    cron: Annotated[str, typer.Option(help="When: minute, hour, day of month, month, day of week, or @daily.")],
    timezone: Annotated[str, typer.Option(help="Of the cron expression, such as Europe/Berlin.")] = "UTC",
    policy: Annotated[list[str] | None, typer.Option("--policy", help="Only this policy. Repeatable.")] = None,
    task: Annotated[list[str] | None, typer.Option("--task", help="Only this task. Repeatable.")] = None,
    seeds: Annotated[int | None, typer.Option("--seeds", min=1, help="Only the first so many seeds.")] = None,
    media: Annotated[bool, typer.Option(help="Film successes and failures.")] = True,
    catch_up: Annotated[
        CatchUp, typer.Option(help="What becomes of runs that were missed: the latest, all or none is run.")
    ] = CatchUp.LATEST,
    keep: Annotated[int | None, typer.Option(min=1, help="Run folders to keep; by default all.")] = None,
    gate: Annotated[bool, typer.Option(help="Hold each run against the last good one.")] = True,
    url: HistoryUrl = None,
) -> None:
    """Add a schedule. It runs while `gauntlet schedule serve` does."""
    path = Path(suite)
    given = str(path.resolve()) if path.suffix in (".yaml", ".yml") or path.exists() else suite
    plan = plan_of(given, part=Part(tuple(policy or ()), tuple(task or ()), seeds))
    arguments = [*(f"--policy={one}" for one in policy or ()), *(f"--task={one}" for one in task or ())]
    arguments += [f"--seeds={seeds}"] if seeds else []
    arguments += [] if media else ["--no-media"]
    try:
        schedule = checked(
            Schedule(name, given, cron, timezone, tuple(arguments), catch_up, keep, gate, created_at=time.time())
        )
        with _desk(url) as desk:
            desk.book.add(schedule)
    except ScheduleError as error:
        raise BadInput(str(error)) from None
    out.print(f"{name}: {plan.episodes:,} episodes of {plan.suite.name}, next at {_moment(schedule)}", markup=False)


@app.command("list")
def list_schedules(
    target: Annotated[
        Target | None, typer.Option("--print", help="Print them for systemd, cron or GitHub Actions instead.")
    ] = None,
    name: Annotated[str | None, typer.Option("--name", help="Only this one.")] = None,
    url: HistoryUrl = None,
) -> None:
    """List schedules, when they are due next, and what became of the last."""
    with _desk(url) as desk:
        found = [desk.schedule(name)] if name else desk.book.schedules()
        lasts = {one.name: desk.book.firings(schedule=one.name, limit=1) for one in found}
    if target is not None:
        try:
            for one in found:
                out.print(hand_over(one, target, Path.cwd()), markup=False, soft_wrap=True, end="")
        except ScheduleError as error:
            raise BadInput(str(error)) from None
        return
    if not found:
        out.print("no schedule yet; add one: gauntlet schedule add nightly SUITE --cron '0 2 * * *'", markup=False)
        return
    rows = []
    for one in found:
        last = lasts[one.name][0] if lasts[one.name] else None
        state = NOTHING if last is None else f"{last.state}: {last.outcome}" if last.outcome else str(last.state)
        rows.append((one.name, one.suite, f"{one.cron} {one.timezone}", _moment(one), state))
    out.print(rich_table(TextTable(("name", "suite", "when", "next", "last"), tuple(rows), 5), title="schedules"))


@app.command()
def remove(
    name: Annotated[str, typer.Argument(help="A schedule's name.")],
    url: HistoryUrl = None,
) -> None:
    """Remove a schedule. Its runs stay."""
    with _desk(url) as desk:
        desk.schedule(name)
        desk.book.remove(name)
    out.print(f"{name}: removed, its runs stay", markup=False)


@app.command("run-now")
def run_now(
    name: Annotated[str, typer.Argument(help="A schedule's name.")],
    url: HistoryUrl = None,
) -> None:
    """Run a schedule now, as if it were due. Exit code 1: worse than the last good run, or not played."""
    with _desk(url) as desk:
        schedule = desk.schedule(name)
        server = desk.server()
        try:
            with served_alone(desk.book.database, desk.root):
                firing = desk.book.fire(schedule, time.time(), server.folder)
                out.print(f"{name}: into {firing.folder}", markup=False, soft_wrap=True)
                closed = server.play(schedule, firing)
        except AlreadyServed:
            firing = desk.book.fire(schedule, time.time(), server.folder)
            out.print(f"{name}: the process that serves the calendar begins it, into {firing.folder}", markup=False)
            return
        except OSError as error:
            raise BadInput(f"{desk.root}: {error.strerror}") from None
        verdict = desk.history.find(closed.run_id or "")
    out.print(f"{name}: {closed.state}, {closed.outcome}", markup=False, soft_wrap=True)
    if closed.state is not State.DONE or (verdict is not None and verdict.verdict == "regressed"):
        raise typer.Exit(1)


@app.command()
def serve(
    at_once: Annotated[int, typer.Option(min=1, help="Runs at the same time, at most; of a suite never two.")] = 1,
    url: HistoryUrl = None,
) -> None:
    """Begin runs when they are due, until stopped. Killed and started again, it goes on where it was."""
    told = _tellers()
    with _desk(url) as desk:
        try:
            with served_alone(desk.book.database, desk.root):
                names = ", ".join(one.name for one in desk.book.schedules()) or "no schedule yet"
                ways = ", ".join(one.name for one in told) or "nothing but this log"
                _log(f"serving {names}; people are told by {ways}")
                desk.server(at_once).serve()
        except AlreadyServed as error:
            raise BadInput(str(error)) from None


@app.command("test-message")
def test_message() -> None:
    """Send a message the way that regressions are told, to see whether it arrives."""
    told = _tellers()
    if not told:
        raise BadInput("nobody is told: set GAUNTLET_WEBHOOK_URL, or GAUNTLET_SMTP_HOST and GAUNTLET_MAIL_TO")
    problems = tell(Message(Kind.TEST, "RoboGauntlet: a test", ("If you read this, messages arrive.",), "none"), told)
    if problems:
        raise BadInput("\n".join(problems))
    out.print("sent")


@contextmanager
def _desk(url: str | None) -> Iterator[Desk]:
    with open_history(url) as history:
        try:
            book = Book.open(history.url)
            try:
                yield Desk(book, history, runs_root(url).absolute())
            finally:
                book.close()
        except StoreError as error:
            raise BadInput(str(error)) from None


def _tellers() -> list[Teller]:
    try:
        return list(tellers(os.environ))
    except TellingError as error:
        raise BadInput(str(error)) from None


def _say(told: list[Teller]) -> Say:
    def say(message: Message) -> None:
        _log(message.title)
        for problem in tell(message, told):
            fail(problem)

    return say


def _log(line: str) -> None:
    out.print(f"{datetime.now():%Y-%m-%d %H:%M:%S}  {line}", markup=False, soft_wrap=True)


def _moment(schedule: Schedule) -> str:
    moment = schedule.next_due(time.time())
    return "never" if moment is None else f"{when(moment)} UTC"
