"""The process that begins runs when they are due. It may be killed at any moment: everything is in the book.

What is due is written down once (`Book.take_note`). Each firing has a run folder of its own, and a run is continued by
beginning it again in its folder, so a firing is played once however often this process dies. A run goes on without this
process; the next one waits for it (the folder's lock goes with whoever holds it).
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
from filelock import FileLock, Timeout

from orchestrator.calendar.book import Book
from orchestrator.calendar.playing import Playing, Say, begin, conclude, has_ended, is_under_way, missed
from orchestrator.calendar.schedule import CatchUp, Firing, Schedule, State
from results.database import Database, StoreError
from results.history import History

LATE_S = 60.0
"""A run that was due longer ago than this, and has not begun, is one to be caught up (s)."""
POLL_S = 1.0
DEATHS = 3
"""Times that the process of one run may be killed before it is left alone."""
PATIENCE_S = 30.0
"""Time for a run to store its rows when the server is stopped (s)."""
_ADVISORY = 0x60D9_4A11
"""Number of the lock on PostgreSQL."""


class AlreadyServed(Exception):
    """Another process serves this calendar; the message says so."""


class Server:
    """Begins, watches and concludes runs."""

    def __init__(
        self,
        book: Book,
        history: History,
        root: Path,
        *,
        say: Say,
        log: Callable[[str], None],
        at_once: int = 1,
        now: Callable[[], float] = time.time,
    ) -> None:
        """Prepare to serve.

        Args:
            book: Of the calendar.
            history: Of the runs.
            root: Folder of run folders.
            say: Tells people.
            log: Takes lines about what is done.
            at_once: Runs at the same time, at most, and of a suite never two.
            now: Seconds since 1970, UTC.
        """
        self._book, self._history, self._root = book, history, root
        self._say, self._log, self._at_once, self._now = say, log, at_once, now
        self._playing: list[Playing] = []
        self._deaths: dict[tuple[str, float], int] = {}

    def serve(self) -> None:
        """Serve until stopped from outside; then let the runs store what they have."""
        try:
            while True:
                try:
                    self.step()
                except StoreError as error:  # a database that is away for a while
                    self._log(f"the calendar cannot be read: {error}; trying again")
                time.sleep(POLL_S)
        finally:
            self.stop()

    def step(self) -> None:
        """Do what there is to do now. Raises StoreError."""
        for playing in list(self._playing):
            code = playing.process.poll()
            if code is not None:
                self._playing.remove(playing)
                self._ended(playing, code)
        self._book.take_note(self._now(), self.folder)
        schedules = {schedule.name: schedule for schedule in self._book.schedules()}
        busy = self._adopt(schedules)
        for schedule in schedules.values():
            for firing in self._wanted(schedule):
                if len(busy) >= self._at_once or schedule.suite in busy:
                    break
                busy.append(schedule.suite)
                self._begin(schedule, firing)

    def play(self, schedule: Schedule, firing: Firing) -> Firing:
        """Play one firing and wait for it. Raises StoreError, OSError."""
        self._book.change(firing, state=State.RUNNING, began_at=time.time())
        playing = begin(schedule, firing, self._history.url)
        try:
            code = playing.process.wait()
        except KeyboardInterrupt:
            self._playing.append(playing)
            self.stop()
            raise
        return conclude(self._book, self._history, schedule, firing, code, self._say)

    def stop(self) -> None:
        """Ask the runs to store what they have, and wait for them. They are continued by the next server."""
        for playing in self._playing:
            playing.process.send_signal(signal.SIGTERM)
        for playing in self._playing:
            with contextlib.suppress(subprocess.TimeoutExpired):
                playing.process.wait(PATIENCE_S)
        self._playing = []

    def folder(self, schedule: Schedule, due_at: float) -> str:
        """Where the run of a schedule that was due at a time goes."""
        moment = datetime.fromtimestamp(due_at, UTC)
        return str((self._root / f"{schedule.name}-{moment:%Y%m%d-%H%M%S}").absolute())

    def _wanted(self, schedule: Schedule) -> list[Firing]:
        """The firings of a schedule that are to begin, the oldest first; the others are missed."""
        due = self._book.firings(schedule=schedule.name, state=State.DUE)[::-1]
        by_hand = [firing for firing in due if firing.by_hand]
        clock = [firing for firing in due if not firing.by_hand]
        keep = clock
        if schedule.catch_up is CatchUp.SKIP:
            keep = [firing for firing in clock if self._now() - firing.due_at <= LATE_S]
        elif schedule.catch_up is CatchUp.LATEST:
            keep = clock[-1:]
        if lost := [firing for firing in clock if firing not in keep]:
            self._log(f"{schedule.name}: missed, {missed(self._book, lost, self._say)}")
        return sorted(by_hand + keep, key=lambda firing: firing.due_at)

    def _adopt(self, schedules: dict[str, Schedule]) -> list[str]:
        """Suites that run; those that an earlier server left are waited for, continued or concluded."""
        busy = [playing.schedule.suite for playing in self._playing]
        ours = {(playing.firing.schedule, playing.firing.due_at) for playing in self._playing}
        for firing in self._book.firings(state=State.RUNNING)[::-1]:
            if (firing.schedule, firing.due_at) in ours:
                continue
            schedule = schedules.get(firing.schedule)
            if is_under_way(Path(firing.folder)):
                busy.append(schedule.suite if schedule else firing.schedule)
            elif schedule is None:
                self._book.change(firing, state=State.FAILED, outcome="its schedule was removed while it ran")
            elif has_ended(Path(firing.folder)):
                self._conclude(schedule, firing, None)
            elif len(busy) < self._at_once and schedule.suite not in busy:
                self._log(f"{schedule.name}: going on with {Path(firing.folder).name}")
                busy.append(schedule.suite)
                self._begin(schedule, firing)
        return busy

    def _begin(self, schedule: Schedule, firing: Firing) -> None:
        if firing.state is State.DUE:
            self._book.change(firing, state=State.RUNNING, began_at=time.time())
            self._log(f"{schedule.name}: {Path(firing.folder).name} begins")
        try:
            self._playing.append(begin(schedule, firing, self._history.url))
        except OSError as error:
            outcome = f"it could not begin: {error.strerror}"
            self._log(f"{schedule.name}: {outcome}")
            self._book.change(firing, state=State.FAILED, ended_at=time.time(), outcome=outcome)

    def _ended(self, playing: Playing, code: int) -> None:
        key = (playing.firing.schedule, playing.firing.due_at)
        if code > 0 and is_under_way(Path(playing.firing.folder)):
            return  # the process of an earlier server was quicker; it is waited for
        if code < 0:  # killed: for want of memory, say
            self._deaths[key] = self._deaths.get(key, 0) + 1
            self._log(f"{playing.schedule.name}: its process was killed (signal {-code})")
            if self._deaths[key] < DEATHS:
                return  # it is adopted, and continued
        self._conclude(playing.schedule, playing.firing, code)

    def _conclude(self, schedule: Schedule, firing: Firing, code: int | None) -> None:
        closed = conclude(self._book, self._history, schedule, firing, code, self._say)
        self._log(f"{schedule.name}: {closed.state}, {closed.outcome}")


@contextlib.contextmanager
def served_alone(database: Database, root: Path) -> Iterator[None]:
    """Keep other servers of this calendar out, as long as this process lives.

    Raises:
        AlreadyServed: There is one.
        StoreError: The database cannot be reached.
    """
    if database.engine.dialect.name == "postgresql":
        with database.reading() as connection:
            connection.detach()  # it is closed afterwards, and its lock with it, instead of going back into the pool
            if not connection.scalar(sa.select(sa.func.pg_try_advisory_lock(_ADVISORY))):
                raise AlreadyServed(f"another process serves the calendar in {database.where}")
            connection.commit()  # no transaction has to stay open for a lock of the connection
            yield
        return
    lock = FileLock(root / ".schedule.lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise AlreadyServed(f"another process serves the calendar in {root}") from None
    try:
        yield
    finally:
        lock.release()
