"""Runs of schedules: each in a process of its own, compared with its baseline, with notifications and old folders."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from time import sleep, time
from urllib.parse import quote

from robogauntlet.orchestrator.runs.regression_check import check_regression
from robogauntlet.orchestrator.schedules.notifications import Message, message_for
from robogauntlet.orchestrator.schedules.schedule import SCHEDULE_VARIABLE, Schedule
from robogauntlet.orchestrator.schedules.store import ScheduleStore
from robogauntlet.results.analysis.comparison import RunComparison
from robogauntlet.results.folder_lock import LOCK_FILE
from robogauntlet.results.report.formatting import counted
from robogauntlet.results.report.history_tables import run_rate
from robogauntlet.results.run_document import RUN_FILE, RunDocument, RunError, RunStatus, read_run
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.history_import import record_run_folder
from robogauntlet.results.store.run_history import History
from robogauntlet.support.errors import BadInput, describe, last_line
from robogauntlet.support.files import exclusive, is_held
from robogauntlet.support.secret_variables import SERVER_SECRETS

POLL_S = 5.0
"""How often a server reports, and looks for what is due (s)."""
STOP_TIMEOUT_S = 30.0
"""Time for a run to store its rows when the server is stopped (s)."""
LOG_FILE = "run.log"
BAD_INPUT = 2
"""Exit code of a run that could not be started."""
COMMAND = (sys.executable, "-P", "-c", "from robogauntlet.orchestrator.cli import main; main()", "run")


class AlreadyRunning(BadInput):
    """Another process runs this schedule, or serves the schedules of this folder."""


@dataclass(frozen=True)
class Outcome:
    """How a run of a schedule has ended."""

    text: str
    """One line."""
    run_id: str | None = None
    """None: it has not started."""
    is_good: bool = False
    """Whether it is complete, and not worse than its baseline."""


@dataclass(frozen=True)
class Runner:
    """Runs schedules into folders under a root."""

    store: ScheduleStore
    history: History
    root: Path
    send: Callable[[Message], None]
    """Sends a notification."""
    log: Callable[[str], None]
    """Takes lines about the progress."""
    public: str | None = None
    """Address of the dashboard, for links in notifications; by default they are paths."""

    def serve(self, schedules: list[Schedule]) -> None:
        """Run each schedule whenever it is due, one at a time, until stopped from outside.

        What becomes due during another run is run after it, once. Raises AlreadyRunning, StoreError.
        """
        refusal = AlreadyRunning(f"another process serves the schedules of {self.root}")
        with exclusive(self.root / ".schedules.lock", refusal):
            self.store.keep_only([schedule.name for schedule in schedules])
            looked_at = {schedule.name: time() for schedule in schedules}
            while True:
                try:
                    self._step(schedules, looked_at)
                except StoreError as error:  # the database may be back later
                    self.log(f"the schedules cannot be stored: {error}; trying again")
                sleep(POLL_S)

    def _step(self, schedules: list[Schedule], looked_at: dict[str, float]) -> None:
        """Run what became due since it was looked at; a clock that was ahead is forgiven."""
        for schedule in schedules:
            now = time()
            since = min(looked_at[schedule.name], now)
            looked_at[schedule.name] = now
            if schedule.next_due(since) <= now:
                try:
                    self.play(schedule, lambda: self._report(schedules))
                except AlreadyRunning as error:
                    self.log(str(error))
                except Exception as error:  # whatever one schedule does, the others go on
                    self.log(f"{schedule.name}: {describe(error)}")
        self._report(schedules)

    def _report(self, schedules: list[Schedule]) -> None:
        """Tell the dashboard that the schedules are served. Raises StoreError."""
        now = time()
        for schedule in schedules:
            self.store.write(schedule, next_due_at=schedule.next_due(now), seen_at=now)

    def play(self, schedule: Schedule, meanwhile: Callable[[], None] | None = None) -> Outcome:
        """Run a schedule now, conclude it and return the outcome.

        A server gives `meanwhile`, which is called every `POLL_S`. Raises AlreadyRunning, StoreError, OSError.
        """
        with exclusive(
            self.root / f".{schedule.name}.lock", AlreadyRunning(f"{schedule.name}: its last run is in progress")
        ):
            folder = self.root / f"{schedule.name}-{datetime.fromtimestamp(time(), UTC):%Y%m%d-%H%M%S}"
            self.log(f"{schedule.name}: {folder.name} starts")
            process = begin(schedule, folder, self.history.url)
            try:
                while process.poll() is None:
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        process.wait(POLL_S)
                    with contextlib.suppress(StoreError):  # the run goes on
                        if meanwhile is not None:
                            meanwhile()
            except BaseException:
                process.send_signal(signal.SIGTERM)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(STOP_TIMEOUT_S)
                raise
            outcome = self.conclude(schedule, folder, process.returncode)
            self.log(f"{schedule.name}: {outcome.text}")
            unserved = {"next_due_at": None, "seen_at": None} if meanwhile is None else {}
            self.store.write(schedule, outcome=outcome.text, run_id=outcome.run_id, **unserved)
            return outcome

    def conclude(self, schedule: Schedule, folder: Path, code: int) -> Outcome:
        """Compare a run that has ended with its baseline, send notifications, and remove old folders.

        Raises:
            StoreError: A store cannot be read or written.
        """
        try:
            document = read_run(folder)
        except RunError:
            outcome = _last_line(folder) or f"the run did not start (exit code {code})"
            self.send(_stopped(schedule, folder, outcome))
            return Outcome(outcome)
        record_run_folder(self.history, folder, document)
        link = self._link(folder, document)
        if document.status is not RunStatus.COMPLETE or code == BAD_INPUT:
            stopped = f"{document.status}: {document.reason or 'the run was stopped'}"
            outcome = _last_line(folder) if code == BAD_INPUT else stopped
            self.send(message_for(document, None, link) or _stopped(schedule, folder, outcome))
            return Outcome(outcome, document.run_id)
        comparison, outcome = self._compared(schedule, document, folder, link)
        if message := message_for(document, comparison, link):
            self.send(message)
        remove_old(self.history, schedule)
        is_worse = comparison is not None and comparison.verdict == "regressed"
        return Outcome(outcome, document.run_id, not is_worse)

    def _compared(
        self, schedule: Schedule, document: RunDocument, folder: Path, link: str
    ) -> tuple[RunComparison | None, str]:
        """The comparison with the baseline run, if there is one and it is wanted, and the outcome in one line."""
        entry = self.history.find(document.run_id)
        rate = "complete"
        if entry is not None:
            rate = f"{run_rate(entry.counts, entry.policies)}, {counted(entry.counts.verdicts, 'episode')}"
        if not schedule.gate:
            return None, rate
        try:
            comparison = check_regression(self.history, document, folder)
        except (RunError, StoreError) as error:
            lines = (str(error), f"to make this run the baseline: robogauntlet compare {folder.name} --accept")
            self.send(Message(f"NOT COMPARED: {folder.name}", lines, folder.name, link))
            return None, f"{rate}; not compared: {error}"
        if comparison is None:
            return None, f"{rate}; the first of its suite"
        return comparison, f"{rate}; {comparison.verdict} against {comparison.baseline}"

    def _link(self, folder: Path, document: RunDocument) -> str:
        """The address of a run's report on the dashboard, or its path."""
        if self.public is None:
            return str(folder / "report.html")
        return f"{self.public}/runs/{quote(document.run_id, safe='')}/files/report.html"


def begin(
    schedule: Schedule, folder: Path, history_url: str, environment: Mapping[str, str] = os.environ
) -> subprocess.Popen[bytes]:
    """Start a run into a folder, where its output goes, too. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    # The URL may contain a password, and the arguments of a process are visible to everyone.
    variables = {name: value for name, value in environment.items() if name not in SERVER_SECRETS}
    variables |= {"ROBOGAUNTLET_HISTORY": history_url, SCHEDULE_VARIABLE: schedule.name}
    command = [*COMMAND, schedule.suite, *schedule.arguments, "--out", str(folder)]
    with (folder / LOG_FILE).open("ab") as log:
        return subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=variables, start_new_session=True
        )


def remove_old(history: History, schedule: Schedule) -> list[Path]:
    """Remove old run folders of a schedule; the results stay in the history.

    The newest `schedule.keep` folders and that of the baseline run are kept.

    Raises:
        StoreError: The history cannot be read or written.
    """
    if schedule.keep is None:
        return []
    entries = [entry for entry in history.runs() if entry.schedule == schedule.name and entry.folder is not None]
    baseline = next((entry.run_id for entry in entries if entry.is_baseline_material), "")
    removed: list[Path] = []
    for entry in entries[schedule.keep :]:
        folder = Path(entry.folder or "")
        if entry.run_id == baseline or not (folder / RUN_FILE).exists() or is_held(folder / LOCK_FILE):
            continue
        history.clear_folder(entry.run_id)
        shutil.rmtree(folder, ignore_errors=True)
        removed.append(folder)
    return removed


def _stopped(schedule: Schedule, folder: Path, outcome: str) -> Message:
    return Message(f"STOPPED: {schedule.name}, {folder.name}", (outcome, f"log: {folder / LOG_FILE}"), folder.name)


def _last_line(folder: Path) -> str:
    """The last line that the run printed, without the program's name."""
    try:
        log = (folder / LOG_FILE).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
    return last_line(log).removeprefix("robogauntlet: ") if log else ""
