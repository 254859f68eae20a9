"""Starts scheduled runs in separate processes and concludes them: regression check, notifications, old folders."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

from robogauntlet.orchestrator.notifications import Message, message_for
from robogauntlet.orchestrator.runs.regression_check import check_regression
from robogauntlet.orchestrator.schedules.schedule import SCHEDULE_VARIABLE, Schedule, ScheduledRun, State
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.analysis.comparison import Comparison
from robogauntlet.results.folder_lock import LOCK_FILE
from robogauntlet.results.report.formatting import counted
from robogauntlet.results.report.history_plot import run_rate, when
from robogauntlet.results.run_document import RUN_FILE, RunDocument, RunError, RunStatus, read_run
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import History
from robogauntlet.support.errors import last_line
from robogauntlet.support.files import is_held
from robogauntlet.support.secret_variables import SERVER_SECRETS

LOG_FILE = "run.log"
BAD_INPUT = 2
"""Exit code of a run that could not be started or continued."""
SendMessage = Callable[[Message], None]


@dataclass
class RunProcess:
    """A scheduled run and the process that this server started for it."""

    schedule: Schedule
    scheduled_run: ScheduledRun
    process: subprocess.Popen[bytes]
    concluded: bool = False
    """Whether the run has ended and was concluded; its process may still record videos."""


def begin(schedule: Schedule, scheduled_run: ScheduledRun, history_url: str) -> RunProcess:
    """Start or continue a scheduled run. Its output goes into its folder.

    Raises:
        OSError: The folder cannot be created, or the process cannot be started.
    """
    folder = Path(scheduled_run.folder)
    folder.mkdir(parents=True, exist_ok=True)
    command = [
        sys.executable,
        "-P",
        "-c",
        "from robogauntlet.orchestrator.cli import main; main()",
        "run",
        schedule.suite,
    ]
    command += [*schedule.arguments, "--out", str(folder)]
    # The URL may contain a password, and the arguments of a process are visible to everyone.
    environment = {name: value for name, value in os.environ.items() if name not in SERVER_SECRETS}
    environment |= {"ROBOGAUNTLET_HISTORY": history_url, SCHEDULE_VARIABLE: schedule.name}
    with (folder / LOG_FILE).open("ab") as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment, start_new_session=True
        )
    return RunProcess(schedule, scheduled_run, process)


def is_running(folder: Path) -> bool:
    """Whether a process writes to this run folder, whoever started it."""
    return is_held(folder / LOCK_FILE)


def has_ended(folder: Path) -> bool:
    """Whether a run is complete or stopped early, and has its report. Its process may still record videos."""
    try:
        document, written_at = read_run(folder), (folder / "report.html").stat().st_mtime
    except (RunError, OSError):
        return False
    ended = document.status in (RunStatus.COMPLETE, RunStatus.STOPPED)
    return ended and document.finished_at is not None and written_at >= document.finished_at


def conclude(
    schedule_store: ScheduleStore,
    history: History,
    schedule: Schedule,
    scheduled_run: ScheduledRun,
    code: int | None,
    send: SendMessage,
    public: str | None = None,
) -> ScheduledRun:
    """Record the outcome of a run that has ended, send notifications and remove old folders.

    After a crash this is repeated: the verdict is the same, notifications may be sent twice. `code` is the exit code of
    the run's process; None if another server started it. Links are to the dashboard at the address `public`, if given.

    Raises:
        StoreError: A store cannot be written.
    """
    folder = Path(scheduled_run.folder)
    try:
        document = read_run(folder)
    except RunError:
        outcome = _last_line(folder) or f"the run did not start (exit code {code})"
        send(_stopped(schedule, folder, outcome))
        return _close(schedule_store, scheduled_run, State.FAILED, outcome)
    record_run_folder(history, folder, document)
    report = _report(folder, document, public)
    if document.status is not RunStatus.COMPLETE or code == BAD_INPUT:
        stopped = f"{document.status}: {document.reason or 'the run was stopped'}"
        outcome = _last_line(folder) if code == BAD_INPUT else stopped
        send(message_for(document, None, report) or _stopped(schedule, folder, outcome))
        return _close(schedule_store, scheduled_run, State.FAILED, outcome, document.run_id)
    comparison, outcome = _check_regression(history, schedule, document, folder, send, report)
    if message := message_for(document, comparison, report):
        send(message)
    closed = _close(schedule_store, scheduled_run, State.DONE, outcome, document.run_id)
    remove_old(schedule_store, history, schedule)
    return closed


def missed(schedule_store: ScheduleStore, scheduled_runs: Sequence[ScheduledRun], send: SendMessage) -> str:
    """Record that runs of one schedule were missed, send one notification about them, and return the reason.

    Raises:
        StoreError: The store cannot be written.
    """
    times = " to ".join(dict.fromkeys(when(run.due_at) for run in (scheduled_runs[0], scheduled_runs[-1])))
    reason = f"due at {times} UTC, when no schedule server ran or another run was in progress"
    for scheduled_run in scheduled_runs:
        _close(schedule_store, scheduled_run, State.MISSED, "no schedule server ran, or another run was in progress")
    name = scheduled_runs[0].schedule
    lines = (reason, f"to run it anyway: robogauntlet schedule run-now {name}")
    send(Message(f"MISSED: {counted(len(scheduled_runs), 'run')} of {name}", lines, name))
    return reason


def remove_old(schedule_store: ScheduleStore, history: History, schedule: Schedule) -> list[Path]:
    """Remove old run folders of a schedule; the results stay in the history.

    The newest `schedule.keep` folders and that of the baseline run are kept.

    Raises:
        StoreError: A store cannot be read or written.
    """
    if schedule.keep is None:
        return []
    runs = schedule_store.scheduled_runs(schedule=schedule.name)
    ended = [run for run in runs if run.state in (State.DONE, State.FAILED)]
    removed: list[Path] = []
    entries = (entry for entry in history.runs() if entry.schedule == schedule.name)
    baseline = next((entry.run_id for entry in entries if entry.is_baseline_material), "")
    for scheduled_run in ended[schedule.keep :]:
        folder = Path(scheduled_run.folder)
        if scheduled_run.run_id == baseline or not (folder / RUN_FILE).exists() or is_running(folder):
            continue
        if scheduled_run.run_id is not None:
            history.clear_folder(scheduled_run.run_id)
        shutil.rmtree(folder, ignore_errors=True)
        removed.append(folder)
    return removed


def _check_regression(
    history: History, schedule: Schedule, document: RunDocument, folder: Path, send: SendMessage, report: str
) -> tuple[Comparison | None, str]:
    """The comparison with the baseline run, if there is one and it is wanted, and the outcome in one line."""
    entry = history.find(document.run_id)
    rate = (
        "complete"
        if entry is None
        else f"{run_rate(entry.counts, entry.policies)}, {counted(entry.counts.verdicts, 'episode')}"
    )
    if not schedule.gate:
        return None, rate
    try:
        comparison = check_regression(history, document, folder)
    except (RunError, StoreError) as error:
        lines = (str(error), f"to make this run the baseline: robogauntlet accept {folder.name}")
        send(Message(f"NOT COMPARED: {folder.name}", lines, folder.name, report))
        return None, f"{rate}; not compared: {error}"
    if comparison is None:
        return None, f"{rate}; the first of its suite"
    return comparison, f"{rate}; {comparison.verdict} against {comparison.baseline}"


def _report(folder: Path, document: RunDocument, public: str | None) -> str:
    """The address of a run's report on the dashboard, or its path."""
    if public is None:
        return str(folder / "report.html")
    return f"{public}/runs/{quote(document.run_id, safe='')}/files/report.html"


def _close(
    schedule_store: ScheduleStore, scheduled_run: ScheduledRun, state: State, outcome: str, run_id: str | None = None
) -> ScheduledRun:
    values = {"state": state, "outcome": outcome, "ended_at": time.time(), "run_id": run_id}
    schedule_store.change(scheduled_run, **values)
    return replace(scheduled_run, **values)  # type: ignore[arg-type]


def _stopped(schedule: Schedule, folder: Path, outcome: str) -> Message:
    return Message(f"STOPPED: {schedule.name}, {folder.name}", (outcome, f"log: {folder / LOG_FILE}"), folder.name)


def _last_line(folder: Path) -> str:
    """The last line that the run printed, without the program's name."""
    try:
        log = (folder / LOG_FILE).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
    return last_line(log).removeprefix("robogauntlet: ") if log else ""
