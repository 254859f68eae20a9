"""The store of schedules and scheduled runs: two tables in the database of the history."""

from __future__ import annotations

import contextlib
import json
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from itertools import islice
from typing import Any

import sqlalchemy as sa

from robogauntlet.orchestrator.schedules.schedule import CatchUp, Schedule, ScheduledRun, ScheduleError, State
from robogauntlet.results.store.database import Database, Schema

VERSION = 1
LOOK_BACK_S = 31 * 86_400.0
"""Runs that were due longer ago, while no schedule server ran, are not recorded (s)."""
MAX_DUE = 1_000
"""Runs of a schedule that are recorded at once, the newest ones; more were due after a long pause only."""
LATE_S = 60.0
"""A run that was due longer ago and has not started is a missed one (s)."""
AHEAD_S = 3600.0
"""A time recorded further in the future than this is due to a clock that was wrong (s)."""
metadata = sa.MetaData()
_version = sa.Table("robogauntlet_schedules", metadata, sa.Column("version", sa.Integer, primary_key=True))
_schedules = sa.Table(
    "schedules",
    metadata,
    sa.Column("name", sa.Text, primary_key=True),
    sa.Column("suite", sa.Text, nullable=False),
    sa.Column("cron", sa.Text, nullable=False),
    sa.Column("timezone", sa.Text, nullable=False),
    sa.Column("arguments", sa.Text, nullable=False),  # JSON
    sa.Column("catch_up", sa.Text, nullable=False),
    sa.Column("keep", sa.BigInteger),
    sa.Column("gate", sa.Boolean, nullable=False),
    sa.Column("created_at", sa.Float(53), nullable=False),
    sa.Column("seen_until", sa.Float(53), nullable=False),  # all due times up to this one are recorded
)
_runs = sa.Table(
    "scheduled_runs",
    metadata,
    sa.Column("schedule", sa.Text, primary_key=True),
    sa.Column("due_at", sa.Float(53), primary_key=True),
    sa.Column("state", sa.Text, nullable=False),
    sa.Column("folder", sa.Text, nullable=False),
    sa.Column("manual", sa.Boolean, nullable=False),
    sa.Column("began_at", sa.Float(53)),
    sa.Column("ended_at", sa.Float(53)),
    sa.Column("outcome", sa.Text, nullable=False),
    sa.Column("run_id", sa.Text),
)
_by_state = sa.Index("robogauntlet_scheduled_runs_by_state", _runs.c.state, _runs.c.due_at)
SCHEMA = Schema(metadata, _version, VERSION, "schedule store")


class ScheduleStore:
    """Schedules and scheduled runs. Any number of processes may read and write."""

    def __init__(self, database: Database) -> None:
        """Use an open database; see `open`."""
        self.database = database

    @classmethod
    def open(cls, url: str) -> ScheduleStore:
        """Open the store in the database at an SQLAlchemy URL; create its tables if they are missing.

        Raises:
            StoreError: The database cannot be reached, is not a store, or belongs to a newer version.
        """
        return cls(Database.open(url, SCHEMA))

    def close(self) -> None:
        """Close the connections."""
        self.database.close()

    def add(self, schedule: Schedule) -> None:
        """Add a schedule. Its times count from its creation.

        Raises:
            ScheduleError: The name is taken.
            StoreError: The database cannot be written.
        """
        values = asdict(schedule) | {
            "arguments": json.dumps(schedule.arguments),
            "catch_up": str(schedule.catch_up),
            "seen_until": schedule.created_at,
        }
        with self.database.writing() as connection:
            statement = self.database.insert_new(_schedules).returning(_schedules.c.name)
            if not connection.execute(statement, [values]).all():
                remedy = f"choose another name, or remove it: robogauntlet schedule remove {schedule.name}"
                raise ScheduleError(f"schedule '{schedule.name}' exists; {remedy}")

    def remove(self, name: str) -> bool:
        """Remove a schedule and its due runs that have not started; False if it does not exist. Raises StoreError."""
        with self.database.writing() as connection:
            removed = connection.execute(sa.delete(_schedules).where(_schedules.c.name == name)).rowcount
            due = sa.delete(_runs).where(_runs.c.schedule == name, _runs.c.state == str(State.DUE))
            connection.execute(due)
        return bool(removed)

    def schedules(self) -> list[Schedule]:
        """Return all schedules in the order of their names. Raises StoreError."""
        with self.database.reading() as connection:
            return [_schedule(row) for row in connection.execute(sa.select(_schedules).order_by(_schedules.c.name))]

    def find(self, name: str) -> Schedule | None:
        """Return the schedule of that name, or None. Raises StoreError."""
        with self.database.reading() as connection:
            row = connection.execute(sa.select(_schedules).where(_schedules.c.name == name)).first()
        return None if row is None else _schedule(row)

    def set_back(self, now: float) -> list[str]:
        """Undo what a clock that was ahead has recorded: runs that are due in the future, and that none is due before.

        Args:
            now: Seconds since 1970, UTC.

        Returns:
            The schedules whose times count from `now` again; none at the next call.

        Raises:
            StoreError: The database cannot be written; it is unchanged.
        """
        is_ahead = _schedules.c.seen_until > now + AHEAD_S
        with self.database.reading() as connection:
            if connection.execute(sa.select(_schedules.c.name).where(is_ahead)).first() is None:
                return []
        with self.database.writing() as connection:
            back = sa.update(_schedules).where(is_ahead).values(seen_until=now).returning(_schedules.c.name)
            names = sorted(connection.execute(back).scalars())
            wrong = sa.and_(
                _runs.c.due_at > now + AHEAD_S, _runs.c.state == str(State.DUE), _runs.c.schedule.in_(names)
            )
            connection.execute(sa.delete(_runs).where(wrong))
        return names

    def record_due(self, now: float, folder: Callable[[Schedule, float], str]) -> int:
        """Record the runs that became due since the last call, each once, also if several processes call.

        Args:
            now: Seconds since 1970, UTC.
            folder: Returns the run folder of a schedule and a due time.

        Returns:
            Number of runs that were recorded.

        Raises:
            StoreError: The database cannot be written; it is unchanged.
        """
        recorded = 0
        with self.database.reading() as connection:
            seen_until = [(_schedule(row), row.seen_until) for row in connection.execute(sa.select(_schedules))]
        for schedule, seen in seen_until:
            moments = deque(schedule.due(max(seen, now - LOOK_BACK_S), now), maxlen=MAX_DUE)
            if not moments:
                continue
            with self.database.writing() as connection:
                clause = sa.and_(_schedules.c.name == schedule.name, _schedules.c.seen_until == seen)
                advanced = connection.execute(sa.update(_schedules).where(clause).values(seen_until=now)).rowcount
                if not advanced:
                    continue  # another process was faster, or the schedule was removed
                for moment in moments:
                    self._insert(connection, schedule.name, moment, folder(schedule, moment), manual=False)
                recorded += len(moments)
        return recorded

    def unserved(self, now: float) -> list[float]:
        """Return the times at which a run was due and none was started or recorded as missed, the oldest first.

        These are at most `MAX_DUE` times of each schedule, and none of the last minute.

        Args:
            now: Seconds since 1970, UTC.

        Raises:
            StoreError: The database cannot be read.
        """
        with self.database.reading() as connection:
            seen = [(_schedule(row), row.seen_until) for row in connection.execute(sa.select(_schedules))]
        found = [run.due_at for run in self.scheduled_runs(state=State.DUE) if run.due_at < now - LATE_S]
        for schedule, until in seen:
            last = [run.due_at for run in self.scheduled_runs(schedule=schedule.name, limit=1)]
            with contextlib.suppress(ScheduleError):  # its time zone is not known here
                found += islice(schedule.due(max(until, now - LOOK_BACK_S, *last), now - LATE_S), MAX_DUE)
        return sorted(found)

    def trigger_now(self, schedule: Schedule, now: float, folder: Callable[[Schedule, float], str]) -> ScheduledRun:
        """Record a run that a person starts now. Raises StoreError."""
        with self.database.writing() as connection:
            self._insert(connection, schedule.name, now, folder(schedule, now), manual=True)
        return self.scheduled_runs(schedule=schedule.name, limit=1)[0]

    def scheduled_runs(
        self, *, schedule: str | None = None, state: State | None = None, limit: int | None = None
    ) -> list[ScheduledRun]:
        """Return scheduled runs, the newest first. Raises StoreError."""
        query = sa.select(_runs).order_by(_runs.c.due_at.desc(), _runs.c.schedule)
        if schedule is not None:
            query = query.where(_runs.c.schedule == schedule)
        if state is not None:
            query = query.where(_runs.c.state == str(state))
        with self.database.reading() as connection:
            return [_scheduled_run(row) for row in connection.execute(query.limit(limit))]

    def change(self, scheduled_run: ScheduledRun, **values: Any) -> None:
        """Write new values of a scheduled run's fields. Raises StoreError."""
        clause = sa.and_(_runs.c.schedule == scheduled_run.schedule, _runs.c.due_at == scheduled_run.due_at)
        plain = {name: str(value) if isinstance(value, State) else value for name, value in values.items()}
        with self.database.writing() as connection:
            connection.execute(sa.update(_runs).where(clause).values(**plain))

    def _insert(self, connection: sa.Connection, name: str, moment: float, folder: str, *, manual: bool) -> None:
        row = {"schedule": name, "due_at": moment, "folder": folder, "manual": manual}
        connection.execute(self.database.insert_new(_runs), [{**row, "state": str(State.DUE), "outcome": ""}])


def _schedule(row: Any) -> Schedule:
    values = {**row._mapping, "arguments": tuple(json.loads(row.arguments)), "catch_up": CatchUp(row.catch_up)}
    del values["seen_until"]
    return Schedule(**values)


def _scheduled_run(row: Any) -> ScheduledRun:
    return ScheduledRun(**{**row._mapping, "state": State(row.state)})
