"""The calendar's tables, in the same database as the history: schedules, and what became of each time they were due."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import sqlalchemy as sa

from orchestrator.calendar.schedule import CatchUp, Firing, Schedule, ScheduleError, State
from results.database import Database, Schema

VERSION = 1
LOOK_BACK_S = 31 * 86_400.0
"""What was due longer ago, while nobody asked, is not written down (s)."""
metadata = sa.MetaData()
_version = sa.Table("robogauntlet_calendar", metadata, sa.Column("version", sa.Integer, primary_key=True))
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
    sa.Column("seen_until", sa.Float(53), nullable=False),  # all times up to this one are among the firings
)
_firings = sa.Table(
    "firings",
    metadata,
    sa.Column("schedule", sa.Text, primary_key=True),
    sa.Column("due_at", sa.Float(53), primary_key=True),
    sa.Column("state", sa.Text, nullable=False),
    sa.Column("folder", sa.Text, nullable=False),
    sa.Column("by_hand", sa.Boolean, nullable=False),
    sa.Column("began_at", sa.Float(53)),
    sa.Column("ended_at", sa.Float(53)),
    sa.Column("outcome", sa.Text, nullable=False),
    sa.Column("run_id", sa.Text),
)
_by_state = sa.Index("robogauntlet_firings_by_state", _firings.c.state, _firings.c.due_at)
SCHEMA = Schema(metadata, _version, VERSION, {}, "calendar")


class Book:
    """Schedules and firings. Any number of processes may read and write."""

    def __init__(self, database: Database) -> None:
        """See `open`."""
        self.database = database

    @classmethod
    def open(cls, url: str) -> Book:
        """Open the calendar in the database at an SQLAlchemy URL; make its tables where they are missing.

        Raises:
            StoreError: It cannot be reached, is something else, or belongs to a newer version.
        """
        return cls(Database.open(url, SCHEMA))

    def close(self) -> None:
        """Free the connections."""
        self.database.close()

    def add(self, schedule: Schedule) -> None:
        """Write a new schedule. It is due from its creation on.

        Raises:
            ScheduleError: There is one of that name.
            StoreError: The database cannot be written.
        """
        values = {name: getattr(schedule, name) for name in ("name", "suite", "cron", "timezone", "keep", "gate")}
        values |= {
            "arguments": json.dumps(schedule.arguments),
            "catch_up": str(schedule.catch_up),
            "created_at": schedule.created_at,
            "seen_until": schedule.created_at,
        }
        with self.database.writing() as connection:
            statement = self.database.insert_new(_schedules).returning(_schedules.c.name)
            if not connection.execute(statement, [values]).all():
                raise ScheduleError(
                    f"there is a schedule '{schedule.name}' already; see: gauntlet schedule list, or remove it first"
                )

    def remove(self, name: str) -> bool:
        """Remove a schedule, and what is due of it and not begun; False if there is none. Raises StoreError."""
        with self.database.writing() as connection:
            found = connection.execute(sa.delete(_schedules).where(_schedules.c.name == name)).rowcount
            due = sa.delete(_firings).where(_firings.c.schedule == name, _firings.c.state == str(State.DUE))
            connection.execute(due)
        return bool(found)

    def schedules(self) -> list[Schedule]:
        """All schedules, by name. Raises StoreError."""
        with self.database.reading() as connection:
            return [_schedule(row) for row in connection.execute(sa.select(_schedules).order_by(_schedules.c.name))]

    def find(self, name: str) -> Schedule | None:
        """The schedule of that name. Raises StoreError."""
        with self.database.reading() as connection:
            row = connection.execute(sa.select(_schedules).where(_schedules.c.name == name)).one_or_none()
        return None if row is None else _schedule(row)

    def take_note(self, now: float, folder: Callable[[Schedule, float], str]) -> int:
        """Write down every time that became due since this was last asked, exactly once whoever else asks.

        Args:
            now: Seconds since 1970, UTC.
            folder: Where the run of a schedule that was due at a time goes.

        Returns:
            How many there were.

        Raises:
            StoreError: The database cannot be written; nothing is changed.
        """
        noted = 0
        for schedule, seen in self._seen():
            moments = list(schedule.due(max(seen, now - LOOK_BACK_S), now))
            if not moments:
                continue
            with self.database.writing() as connection:
                clause = sa.and_(_schedules.c.name == schedule.name, _schedules.c.seen_until == seen)
                moved = connection.execute(sa.update(_schedules).where(clause).values(seen_until=now)).rowcount
                if not moved:
                    continue  # another process was quicker, or it was removed
                for moment in moments:
                    self._insert(connection, schedule.name, moment, folder(schedule, moment), by_hand=False)
                noted += len(moments)
        return noted

    def fire(self, schedule: Schedule, now: float, folder: Callable[[Schedule, float], str]) -> Firing:
        """Write down that a person wants a run now. Raises StoreError."""
        with self.database.writing() as connection:
            self._insert(connection, schedule.name, now, folder(schedule, now), by_hand=True)
        return self.firings(schedule=schedule.name, limit=1)[0]

    def firings(
        self, *, schedule: str | None = None, state: State | None = None, limit: int | None = None
    ) -> list[Firing]:
        """Firings, the newest first. Raises StoreError."""
        query = sa.select(_firings).order_by(_firings.c.due_at.desc(), _firings.c.schedule)
        if schedule is not None:
            query = query.where(_firings.c.schedule == schedule)
        if state is not None:
            query = query.where(_firings.c.state == str(state))
        with self.database.reading() as connection:
            return [_firing(row) for row in connection.execute(query.limit(limit) if limit is not None else query)]

    def change(self, firing: Firing, **values: Any) -> None:
        """Write new values of a firing's fields. Raises StoreError."""
        clause = sa.and_(_firings.c.schedule == firing.schedule, _firings.c.due_at == firing.due_at)
        plain = {name: str(value) if isinstance(value, State) else value for name, value in values.items()}
        with self.database.writing() as connection:
            connection.execute(sa.update(_firings).where(clause).values(**plain))

    def _seen(self) -> list[tuple[Schedule, float]]:
        with self.database.reading() as connection:
            return [(_schedule(row), row.seen_until) for row in connection.execute(sa.select(_schedules))]

    def _insert(self, connection: sa.Connection, name: str, moment: float, folder: str, *, by_hand: bool) -> None:
        row = {
            "schedule": name,
            "due_at": moment,
            "state": str(State.DUE),
            "folder": folder,
            "by_hand": by_hand,
            "outcome": "",
        }
        connection.execute(self.database.insert_new(_firings), [row])


def _schedule(row: Any) -> Schedule:
    return Schedule(
        name=row.name,
        suite=row.suite,
        cron=row.cron,
        timezone=row.timezone,
        arguments=tuple(json.loads(row.arguments)),
        catch_up=CatchUp(row.catch_up),
        keep=row.keep,
        gate=bool(row.gate),
        created_at=row.created_at,
    )


def _firing(row: Any) -> Firing:
    return Firing(
        schedule=row.schedule,
        due_at=row.due_at,
        state=State(row.state),
        folder=row.folder,
        by_hand=bool(row.by_hand),
        began_at=row.began_at,
        ended_at=row.ended_at,
        outcome=row.outcome,
        run_id=row.run_id,
    )
