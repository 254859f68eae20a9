"""What the dashboard shows of schedules: a table in the database of the history, which those write that run them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import sqlalchemy as sa

from robogauntlet.orchestrator.schedules.schedule import Schedule
from robogauntlet.results.store.database import Database, Schema

UNSERVED_S = 60.0
"""A schedule whose server has not reported for longer is not served (s)."""
metadata = sa.MetaData()
_version = sa.Table("robogauntlet_served_schedules", metadata, sa.Column("version", sa.Integer, primary_key=True))
_schedules = sa.Table(
    "served_schedules",
    metadata,
    sa.Column("name", sa.Text, primary_key=True),
    sa.Column("suite", sa.Text, nullable=False),
    sa.Column("cron", sa.Text, nullable=False),
    sa.Column("timezone", sa.Text, nullable=False),
    sa.Column("next_due_at", sa.Float(53)),
    sa.Column("seen_at", sa.Float(53)),
    sa.Column("outcome", sa.Text, nullable=False),
    sa.Column("run_id", sa.Text),
)
SCHEMA = Schema(metadata, _version, 1, "schedule store", 1)


@dataclass(frozen=True)
class ServedSchedule:
    """A schedule as it was last seen. Times are seconds since 1970, UTC."""

    name: str
    suite: str
    cron: str
    timezone: str
    next_due_at: float | None
    """None: no server runs it; a timer or a person does."""
    seen_at: float | None
    """When a server last reported."""
    outcome: str
    """That of the last run, in one line; empty before it."""
    run_id: str | None
    """Id of the last run, if it has started."""

    def is_served(self, now: float) -> bool:
        """Whether a server runs it, or none is meant to."""
        return self.seen_at is None or now - self.seen_at <= UNSERVED_S


class ScheduleStore:
    """Schedules that were served or run. Any number of processes may read and write."""

    def __init__(self, database: Database) -> None:
        """Use an open database; see `open`."""
        self.database = database

    @classmethod
    def open(cls, url: str) -> ScheduleStore:
        """Open the store in the database at an SQLAlchemy URL; create its tables if they are missing.

        Raises:
            StoreError: The database cannot be reached, is not a store, or has another version.
        """
        return cls(Database.open(url, SCHEMA))

    def close(self) -> None:
        """Close the connections."""
        self.database.close()

    def write(self, schedule: Schedule, **values: Any) -> None:
        """Write values of a schedule; others stay. Raises StoreError."""
        values = schedule.model_dump(include={"name", "suite", "cron", "timezone"}) | values
        with self.database.writing() as connection:
            statement = self.database.insert(_schedules).values({"outcome": "", **values})
            connection.execute(statement.on_conflict_do_update(index_elements=["name"], set_=values))

    def keep_only(self, names: list[str]) -> None:
        """Remove all other schedules. Raises StoreError."""
        with self.database.writing() as connection:
            connection.execute(sa.delete(_schedules).where(_schedules.c.name.not_in(names)))

    def schedules(self) -> list[ServedSchedule]:
        """Return all schedules in the order of their names. Raises StoreError."""
        columns = [_schedules.c[one.name] for one in fields(ServedSchedule)]
        with self.database.reading() as connection:
            rows = connection.execute(sa.select(*columns).order_by(_schedules.c.name))
            return [ServedSchedule(**row._mapping) for row in rows]
