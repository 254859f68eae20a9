"""Begins the run of a firing in a process of its own, and concludes it: verdict, messages, old folders."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from filelock import FileLock, Timeout

from orchestrator.calendar.book import Book
from orchestrator.calendar.schedule import Firing, Schedule, State
from orchestrator.folders import LOCK_FILE
from orchestrator.judging import judge
from orchestrator.telling import Kind, Message, message_for
from results.comparison import Comparison
from results.database import StoreError
from results.history import History
from results.report.nights import when
from results.report.text import counted, percent
from results.run import RUN_FILE, RunDocument, RunError, RunStatus, read_run
from results.syncing import take_in_run

LOG_FILE = "run.log"
BAD_INPUT = 2
"""Exit code of a run that could not be begun, or continued."""
Say = Callable[[Message], None]


@dataclass
class Playing:
    """A firing whose run is a process of ours."""

    schedule: Schedule
    firing: Firing
    process: subprocess.Popen[bytes]


def begin(schedule: Schedule, firing: Firing, history_url: str) -> Playing:
    """Begin the run of a firing, or go on with it. What it prints goes into its folder.

    Raises:
        OSError: The folder cannot be made, or the process not be started.
    """
    folder = Path(firing.folder)
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-c", "from orchestrator.cli import main; main()", "run", schedule.suite]
    command += [*schedule.arguments, "--out", str(folder), "--schedule", schedule.name]
    # The history's address may hold a password, and everyone sees the arguments of a process.
    environment = {**os.environ, "GAUNTLET_HISTORY": history_url}
    with (folder / LOG_FILE).open("ab") as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment, start_new_session=True
        )
    return Playing(schedule, firing, process)


def is_under_way(folder: Path) -> bool:
    """Whether a process runs into this folder: one that an earlier server began, or a person."""
    if not (folder / LOCK_FILE).exists():
        return False
    lock = FileLock(folder / LOCK_FILE)
    try:
        lock.acquire(timeout=0)
    except (Timeout, OSError):
        return True
    lock.release()
    return False


def has_ended(folder: Path) -> bool:
    """Whether a run into which nobody plays any more has come to its end, or to one that it chose, and was reported."""
    try:
        status = read_run(folder).status
    except RunError:
        return False
    return status in (RunStatus.COMPLETE, RunStatus.STOPPED) and (folder / "report.html").exists()


def conclude(book: Book, history: History, schedule: Schedule, firing: Firing, code: int | None, say: Say) -> Firing:
    """Write down what a run that has ended came to, tell people what they should know, remove old folders.

    If a crash comes between it is done again: the verdict is the same, and people may be told twice.

    Args:
        book: Of the calendar.
        history: Of the runs.
        schedule: What was due.
        firing: When.
        code: Exit code of its process; None if that was another server's.
        say: Tells people.

    Raises:
        StoreError: The book or the history cannot be written.
    """
    folder = Path(firing.folder)
    try:
        document = read_run(folder)
    except RunError:
        outcome = _last_line(folder) or f"the run did not begin (exit code {code})"
        say(_stopped(schedule, firing, outcome))
        return _close(book, firing, State.FAILED, outcome)
    take_in_run(history, folder, document)
    if document.status is not RunStatus.COMPLETE or code == BAD_INPUT:
        outcome = f"{document.status}: {document.reason or 'it was stopped'}"
        if code == BAD_INPUT:
            outcome = _last_line(folder)
        message = message_for(document, None, str(folder / "report.html"))
        say(message or _stopped(schedule, firing, outcome))
        return _close(book, firing, State.FAILED, outcome, document.run_id)
    comparison, outcome = _judged(history, schedule, document, folder, say)
    message = message_for(document, comparison, str(folder / "report.html"))
    if message is not None:
        say(message)
    closed = _close(book, firing, State.DONE, outcome, document.run_id)
    remove_old(book, history, schedule)
    return closed


def missed(book: Book, firings: Sequence[Firing], say: Say) -> str:
    """Write down that firings of one schedule were not run, and tell people in one message.

    Returns:
        Why, in a line.

    Raises:
        StoreError: The book cannot be written.
    """
    times = when(firings[0].due_at) + (f" to {when(firings[-1].due_at)}" if len(firings) > 1 else "")
    why = f"due at {times} UTC, when nobody served the calendar or another run went on"
    for firing in firings:
        _close(book, firing, State.MISSED, "nobody served the calendar, or another run went on")
    name = firings[0].schedule
    lines = (why, f"run it all the same: gauntlet schedule run-now {name}")
    say(Message(Kind.MISSED, f"MISSED: {counted(len(firings), 'run')} of {name}", lines, name))
    return why


def remove_old(book: Book, history: History, schedule: Schedule) -> list[Path]:
    """Remove the folders of a schedule's runs beyond those that it keeps; their numbers stay in the history.

    A folder that later runs are to be held against is kept as well.

    Raises:
        StoreError: The book or the history cannot be read or written.
    """
    if schedule.keep is None:
        return []
    ended = [f for f in book.firings(schedule=schedule.name) if f.state in (State.DONE, State.FAILED)]
    removed: list[Path] = []
    entries = {entry.run_id: entry for entry in history.runs() if entry.schedule == schedule.name}
    good = next((run_id for run_id, entry in entries.items() if entry.is_baseline_material), None)
    for firing in ended[schedule.keep :]:
        folder = Path(firing.folder)
        if (firing.run_id is not None and firing.run_id == good) or not (folder / RUN_FILE).exists():
            continue
        if is_under_way(folder):
            continue
        if firing.run_id is not None:
            history.lose_folder(firing.run_id)
        shutil.rmtree(folder, ignore_errors=True)
        removed.append(folder)
    return removed


def _judged(
    history: History, schedule: Schedule, document: RunDocument, folder: Path, say: Say
) -> tuple[Comparison | None, str]:
    """The comparison with the last good run, if there is one and it is wanted, and the outcome in a line."""
    entry = history.find(document.run_id)
    rate = f"{percent(entry.counts.rate)} of {entry.counts.verdicts:,} episodes" if entry is not None else "complete"
    if not schedule.gate:
        return None, rate
    try:
        comparison = judge(history, document, folder)
    except (RunError, StoreError) as error:
        lines = (str(error), f"to hold later runs against this one: gauntlet accept {folder.name}")
        say(Message(Kind.UNJUDGED, f"NOT COMPARED: {folder.name}", lines, folder.name, str(folder / "report.html")))
        return None, f"{rate}; not compared: {error}"
    if comparison is None:
        return None, f"{rate}; the first of its suite"
    return comparison, f"{rate}; {comparison.verdict} against {comparison.baseline}"


def _close(book: Book, firing: Firing, state: State, outcome: str, run_id: str | None = None) -> Firing:
    values = {"state": state, "outcome": outcome, "ended_at": time.time(), "run_id": run_id}
    book.change(firing, **values)
    return replace(firing, **values)  # type: ignore[arg-type]


def _stopped(schedule: Schedule, firing: Firing, outcome: str) -> Message:
    run = Path(firing.folder).name
    lines: Sequence[str] = (outcome, f"its log: {Path(firing.folder) / LOG_FILE}")
    return Message(Kind.STOPPED, f"STOPPED: {schedule.name}, {run}", tuple(lines), run)


def _last_line(folder: Path) -> str:
    """The last line that the run printed, without the program's name."""
    try:
        lines = (folder / LOG_FILE).read_text(encoding="utf-8", errors="replace").strip().splitlines()
    except OSError:
        return ""
    return lines[-1].removeprefix("gauntlet: ") if lines else ""
