"""SQLite and PostgreSQL databases by URL: opening, settings, creation of tables, error messages."""

from __future__ import annotations

import contextlib
import dataclasses
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

BUSY_S = 30.0
"""Time to wait for another process that writes (s)."""
BACKENDS = ("sqlite", "postgresql")


class StoreError(Exception):
    """The store cannot be opened, read or written; the message says why and what to do."""


@dataclasses.dataclass(frozen=True)
class Schema:
    """Tables that belong together."""

    metadata: sa.MetaData
    version_table: sa.Table
    """Table with one column, `version`."""
    version: int
    what: str
    """Name of such a database in messages: "store"."""


class Database:
    """An open database with the tables of a schema."""

    def __init__(self, engine: sa.Engine, where: str) -> None:
        self.engine = engine
        self.where = where

    @classmethod
    def open(cls, url: str, schema: Schema) -> Database:
        """Open the database at an SQLAlchemy URL; create missing tables.

        Raises:
            StoreError: It cannot be reached, is not a database, or has another version (and stays unchanged).
        """
        parsed = parse(url)
        where = parsed.render_as_string(hide_password=True)
        try:
            engine = sa.create_engine(parsed)
        except (ImportError, sa.exc.SQLAlchemyError) as error:
            raise StoreError(f"{where}: {error}") from None
        if parsed.get_backend_name() == "sqlite":
            sa.event.listen(engine, "connect", _tune_sqlite)
        database = cls(engine, where)
        with database.explained():
            database._prepare(schema)
        return database

    def _prepare(self, schema: Schema) -> None:
        existing = set(sa.inspect(self.engine).get_table_names())
        marker = schema.version_table
        if marker.name not in existing and (others := existing & set(schema.metadata.tables)):
            raise StoreError(
                f"{self.where}: not a RoboGauntlet {schema.what}: it has a table {min(others)} of another program"
            )
        if marker.name in existing:
            with self.engine.connect() as connection:
                version = connection.scalar(sa.select(sa.func.max(marker.c.version)))
            if version == schema.version:
                return
            if version is not None:
                raise StoreError(
                    f"{self.where}: expected a {schema.what} of version {schema.version}, got version {version}; "
                    "open it with the RoboGauntlet that wrote it, or name another"
                )
        # Another process may be creating the tables now, or was killed between two: SQLite commits each.
        with self.engine.begin() as connection:
            for table in schema.metadata.sorted_tables:
                connection.execute(sa.schema.CreateTable(table, if_not_exists=True))
                for index in table.indexes:
                    connection.execute(sa.schema.CreateIndex(index, if_not_exists=True))
            connection.execute(self.insert_new(marker).values(version=schema.version))

    def insert_new(self, table: sa.Table) -> Any:
        """An insertion that skips rows whose primary key exists."""
        return self.insert(table).on_conflict_do_nothing()

    def insert(self, table: sa.Table) -> Any:
        """An insertion of the dialect, which has clauses for conflicts."""
        dialect = postgresql if self.engine.dialect.name == "postgresql" else sqlite
        return dialect.insert(table)

    @contextlib.contextmanager
    def reading(self) -> Iterator[sa.Connection]:
        """A connection to read on. Raises StoreError."""
        with self.explained(), self.engine.connect() as connection:
            yield connection

    @contextlib.contextmanager
    def writing(self) -> Iterator[sa.Connection]:
        """A connection in a transaction. Raises StoreError."""
        with self.explained(), self.engine.begin() as connection:
            yield connection

    @contextlib.contextmanager
    def explained(self) -> Iterator[None]:
        """Raise database errors of the block as StoreError with one line."""
        try:
            yield
        except sa.exc.DBAPIError as error:
            reason = str(error.orig).splitlines()[0]
            if "not a database" in reason:
                reason = "expected a store, this file is something else"
            if "readonly database" in reason:
                reason = "expected a store in a place that can be written, which reading takes too; copy it to one"
            raise StoreError(f"{self.where}: {reason}") from error
        except sa.exc.SQLAlchemyError as error:
            raise StoreError(f"{self.where}: {str(error).splitlines()[0]}") from error

    def close(self) -> None:
        """Free the connections."""
        self.engine.dispose()


def parse(url: str) -> sa.URL:
    """Parse a database URL. Raises StoreError: not a URL, or not of SQLite or PostgreSQL."""
    try:
        parsed = sa.make_url(url)
    except sa.exc.ArgumentError:
        raise StoreError(
            f"not a store URL: {url}; expected sqlite:///FILE or postgresql+psycopg://HOST/DATABASE"
        ) from None
    if parsed.get_backend_name() not in BACKENDS:
        where = parsed.render_as_string(hide_password=True)
        raise StoreError(f"{where}: expected an sqlite or postgresql URL, got {parsed.get_backend_name()}")
    return parsed


def without_password(url: str) -> str:
    """Return a database URL with its password hidden. Raises StoreError."""
    return parse(url).render_as_string(hide_password=True)


def file_url(path: Path) -> str:
    """Return the URL of an SQLite store in a file, with special characters of its name quoted."""
    return f"sqlite:///{quote(str(path))}"


def _tune_sqlite(connection: sqlite3.Connection, _record: Any) -> None:
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout={int(1000 * BUSY_S)}")
    cursor.execute("PRAGMA trusted_schema=OFF")  # The file may be from an untrusted source.
    deadline = time.monotonic() + BUSY_S
    while True:
        try:
            cursor.execute("PRAGMA journal_mode=WAL")
            break
        except sqlite3.OperationalError as error:
            # SQLite ignores the time-out here while another process opens the store.
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(0.01)
    cursor.execute("PRAGMA synchronous=NORMAL")
    cursor.close()
