"""The schedule server: the process that starts runs when they are due.

It may be killed at any moment, since its state is in the database. Each due run is recorded once
(`ScheduleStore.record_due`) and has its own folder, in which it is started or continued. A run continues without the
server; the next server waits for it (the lock of the folder is released when its process ends).
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import sqlalchemy as sa

from robogauntlet.orchestrator.notifications import Message
from robogauntlet.orchestrator.schedules.run_process import (
    RunProcess,
    SendMessage,
    begin,
    conclude,
    has_ended,
    is_running,
    missed,
)
from robogauntlet.orchestrator.schedules.schedule import CatchUp, Schedule, ScheduledRun, State
from robogauntlet.orchestrator.schedules.store import LATE_S, ScheduleStore
from robogauntlet.results.report.history_plot import when
from robogauntlet.results.store.database import Database, StoreError
from robogauntlet.results.store.run_history import History
from robogauntlet.support.errors import BadInput, describe, describe_os_error
from robogauntlet.support.files import exclusive, is_held
from robogauntlet.support.text import counted

POLL_S = 1.0
MAX_KILLS = 3
"""Number of times that the process of a run may be killed before the run is given up."""
STOP_TIMEOUT_S = 30.0
"""Time for a run to store its rows when the server is stopped (s)."""
LOCK_FILE = ".schedule.lock"
_ADVISORY = 0x60D9_4A11
"""Number of the lock on PostgreSQL."""


class AlreadyRunning(BadInput):
    """Another schedule server runs on the same store."""


class Server:
    """Starts, watches and concludes runs."""

    def __init__(
        self,
        schedule_store: ScheduleStore,
        history: History,
        root: Path,
        *,
        send: SendMessage,
        log: Callable[[str], None],
        max_parallel: int = 1,
        now: Callable[[], float] = time.time,
        public: str | None = None,
    ) -> None:
        """Prepare to serve.

        Args:
            schedule_store: Store of the schedules.
            history: History of the runs.
            root: Folder of the run folders.
            send: Sends a notification.
            log: Takes lines about the progress.
            max_parallel: Largest number of simultaneous runs; two runs of a suite are never simultaneous.
            now: Returns the time (seconds since 1970, UTC).
            public: Address of the dashboard, for links in notifications; by default they are paths.
        """
        self._public = public
        self._store, self._history, self._root = schedule_store, history, root
        self._send, self._log, self._max_parallel, self._now = send, log, max_parallel, now
        self._processes: list[RunProcess] = []
        self._kills: dict[tuple[str, float], int] = {}

    def serve(self) -> None:
        """Serve until stopped from outside; then let the runs store what they have."""
        try:
            while True:
                try:
                    self.step()
                except StoreError as error:  # the database may be back later
                    self._log(f"the schedules cannot be read: {error}; trying again")
                except Exception as error:  # whatever one run or schedule does, the others go on
                    self._log(f"a step of the schedules failed: {describe(error)}; trying again")
                time.sleep(POLL_S)
        finally:
            self.stop()

    def step(self) -> None:
        """Start, watch and conclude runs once. Raises StoreError."""
        for running in list(self._processes):
            code = running.process.poll()
            if code is not None:
                self._processes.remove(running)
            if running.concluded:
                continue
            if code is not None:
                self._ended(running, code)
            elif has_ended(Path(running.scheduled_run.folder)):
                self._conclude(running.schedule, running.scheduled_run, None)
                running.concluded = True
        for name in self._store.set_back(self._now()):
            self._log(f"{name}: its runs are due from this moment on, because the clock was ahead")
            line = "the clock was ahead; runs that were due until it was right again are missed"
            self._send(Message(f"CLOCK: {name} is served again", (line,), name))
        self._store.record_due(self._now(), self.folder)
        schedules = {schedule.name: schedule for schedule in self._store.schedules()}
        busy = self._adopt(schedules)
        for schedule in schedules.values():
            for scheduled_run in self._wanted(schedule):
                if len(busy) >= self._max_parallel or schedule.suite in busy:
                    break
                busy.append(schedule.suite)
                self._begin(schedule, scheduled_run)

    def play(self, schedule: Schedule, scheduled_run: ScheduledRun) -> ScheduledRun:
        """Run one scheduled run, conclude it and wait for its process. Raises StoreError, OSError."""
        self._store.change(scheduled_run, state=State.RUNNING, began_at=time.time())
        running = begin(schedule, scheduled_run, self._history.url)
        code = None
        try:
            while code is None and not has_ended(Path(scheduled_run.folder)):
                with contextlib.suppress(subprocess.TimeoutExpired):
                    code = running.process.wait(POLL_S)
            concluded = conclude(self._store, self._history, schedule, scheduled_run, code, self._send, self._public)
            running.process.wait()
        except KeyboardInterrupt:
            self._processes.append(running)
            self.stop()
            raise
        return concluded

    def stop(self) -> None:
        """Interrupt the runs and wait until they have stored their rows. The next server continues them."""
        for running in self._processes:
            running.process.send_signal(signal.SIGTERM)
        for running in self._processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                running.process.wait(STOP_TIMEOUT_S)
        self._processes = []

    def folder(self, schedule: Schedule, due_at: float) -> str:
        """Return the run folder of a schedule and a due time."""
        moment = datetime.fromtimestamp(due_at, UTC)
        return str((self._root / f"{schedule.name}-{moment:%Y%m%d-%H%M%S}").absolute())

    def _wanted(self, schedule: Schedule) -> list[ScheduledRun]:
        """The due runs of a schedule that are to start, the oldest first; the others are recorded as missed."""
        due = self._store.scheduled_runs(schedule=schedule.name, state=State.DUE)[::-1]
        by_clock = [run for run in due if not run.manual]
        lost: list[ScheduledRun] = []
        if schedule.catch_up is CatchUp.SKIP:
            lost = [run for run in by_clock if self._now() - run.due_at > LATE_S]
        elif schedule.catch_up is CatchUp.LATEST:
            lost = by_clock[:-1]
        if lost:
            self._log(f"{schedule.name}: missed, {missed(self._store, lost, self._send)}")
        return [run for run in due if run not in lost]

    def _adopt(self, schedules: dict[str, Schedule]) -> list[str]:
        """Return the suites in progress; wait for, continue or conclude the runs of an earlier server."""
        busy = [running.schedule.suite for running in self._processes]
        ours = {(running.scheduled_run.schedule, running.scheduled_run.due_at) for running in self._processes}
        for scheduled_run in self._store.scheduled_runs(state=State.RUNNING)[::-1]:
            if (scheduled_run.schedule, scheduled_run.due_at) in ours:
                continue
            schedule = schedules.get(scheduled_run.schedule)
            if is_running(Path(scheduled_run.folder)):
                busy.append(schedule.suite if schedule else scheduled_run.schedule)
            elif schedule is None:
                outcome = "the schedule was removed while the run was in progress"
                self._store.change(scheduled_run, state=State.FAILED, outcome=outcome)
            elif has_ended(Path(scheduled_run.folder)):
                self._conclude(schedule, scheduled_run, None)
            elif len(busy) < self._max_parallel and schedule.suite not in busy:
                self._log(f"{schedule.name}: continuing {Path(scheduled_run.folder).name}")
                busy.append(schedule.suite)
                self._begin(schedule, scheduled_run)
        return busy

    def _begin(self, schedule: Schedule, scheduled_run: ScheduledRun) -> None:
        if scheduled_run.state is State.DUE:
            self._store.change(scheduled_run, state=State.RUNNING, began_at=time.time())
            self._log(f"{schedule.name}: {Path(scheduled_run.folder).name} starts")
        try:
            self._processes.append(begin(schedule, scheduled_run, self._history.url))
        except StoreError:
            raise
        except Exception as error:
            reason = describe_os_error(error) if isinstance(error, OSError) else describe(error)
            outcome = f"the run could not start: {reason}"
            self._log(f"{schedule.name}: {outcome}")
            self._store.change(scheduled_run, state=State.FAILED, ended_at=time.time(), outcome=outcome)

    def _ended(self, running: RunProcess, code: int) -> None:
        key = (running.scheduled_run.schedule, running.scheduled_run.due_at)
        if code > 0 and is_running(Path(running.scheduled_run.folder)):
            return  # the process of an earlier server was faster; wait for that one
        if code < 0:  # killed, for example when memory is exhausted
            self._kills[key] = self._kills.get(key, 0) + 1
            self._log(f"{running.schedule.name}: its process was killed (signal {-code})")
            if self._kills[key] < MAX_KILLS:
                return  # it will be adopted and continued
        self._conclude(running.schedule, running.scheduled_run, code)

    def _conclude(self, schedule: Schedule, scheduled_run: ScheduledRun, code: int | None) -> None:
        try:
            closed = conclude(self._store, self._history, schedule, scheduled_run, code, self._send, self._public)
        except StoreError:
            raise
        except Exception as error:  # the run is over, whatever it has left; the others go on
            outcome = f"the run could not be concluded: {describe(error)}"
            self._log(f"{schedule.name}: {outcome}")
            self._store.change(scheduled_run, state=State.FAILED, ended_at=time.time(), outcome=outcome)
            return
        self._log(f"{schedule.name}: {closed.state}, {closed.outcome}")


@contextlib.contextmanager
def exclusive_server(database: Database, root: Path) -> Iterator[None]:
    """Keep other servers from these schedules while the block runs.

    Raises:
        AlreadyRunning: Another server runs.
        StoreError: The database cannot be reached.
    """
    if database.engine.dialect.name == "postgresql":
        with database.reading() as connection:
            connection.detach()  # so that it is closed afterwards, whatever happens
            if not connection.scalar(sa.select(sa.func.pg_try_advisory_lock(_ADVISORY))):
                raise AlreadyRunning(f"another schedule server runs on {database.where}")
            connection.commit()  # the lock needs the connection, not a transaction
            try:
                yield
            finally:
                # Without it, PostgreSQL keeps the lock until it notices that the connection was closed.
                with contextlib.suppress(sa.exc.SQLAlchemyError):
                    connection.scalar(sa.select(sa.func.pg_advisory_unlock(_ADVISORY)))
        return
    with exclusive(root / LOCK_FILE, AlreadyRunning(f"another schedule server runs on {root}")):
        yield


def is_served(database: Database, root: Path) -> bool:
    """Whether a process holds `exclusive_server`, which a look does not take. Raises StoreError."""
    if database.engine.dialect.name != "postgresql":
        return is_held(root / LOCK_FILE)
    held = (
        "SELECT 1 FROM pg_locks WHERE locktype = 'advisory' AND granted AND objid = :number "
        "AND database = (SELECT oid FROM pg_database WHERE datname = current_database())"
    )
    with database.reading() as connection:
        return connection.scalar(sa.text(held), {"number": _ADVISORY}) is not None


def why_unserved(schedule_store: ScheduleStore, root: Path, now: float) -> str | None:
    """Return a line if there are schedules that no process serves, with the runs that were due meanwhile, else None.

    Raises:
        StoreError: The database cannot be read.
    """
    if not schedule_store.schedules():
        return None
    if is_served(schedule_store.database, root):
        return None
    remedy = "; start one: robogauntlet schedule serve"
    if not (times := schedule_store.unserved(now)):
        return f"no process serves the schedules{remedy}"
    runs = counted(len(times), "run was due", "runs were due")
    return f"no process serves the schedules: {runs} since {when(times[0])} UTC{remedy}"
