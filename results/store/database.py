"""SQLite and PostgreSQL databases by URL: opening, settings, creation of tables, error messages."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import sqlalchemy as sa
from sqlalchemy.dialects import sqlite

from robogauntlet.results.store.sqlite_file import (
    BUSY_S,
    file_of,
    tune,
    use_write_ahead_log,
    why_no_database,
    why_no_url,
    why_not_opened,
)
from robogauntlet.support.errors import first_line

BACKENDS = ("sqlite", "postgresql")
_UNQUOTES = sa.make_url("sqlite:///%41").database == "A"
"""Whether SQLAlchemy undoes `file_url`'s quotes, as it does since 2.1."""
_SECRET = re.compile("pass|secret|token|key", re.IGNORECASE)
"""In names of a URL's query: `password`, `sslpassword`, `passfile`, `sslkey`, `oauth_client_secret`."""


class StoreError(Exception):
    """The store cannot be opened, read or written; the message says why and what to do."""


class UnstorableValue(StoreError):
    """A value that the database cannot hold, such as a number beyond 64 bits."""


@dataclasses.dataclass(frozen=True)
class Schema:
    """Tables that belong together."""

    metadata: sa.MetaData
    version_table: sa.Table
    """Table with one column, `version`."""
    version: int
    what: str
    """Name of such a database in messages: "store"."""
    oldest: int
    """The first version that lacks no more than columns that may be empty, which are added."""


class Database:
    """An open database with the tables of a schema."""

    def __init__(self, engine: sa.Engine, where: str) -> None:
        self.engine = engine
        self.where = where

    @classmethod
    def open(cls, url: str, schema: Schema, *, create: bool = True) -> Database:
        """Open the database at an SQLAlchemy URL; create missing tables unless `create` is false.

        Raises:
            StoreError: It cannot be reached, is not a database, or has another version (and stays unchanged); without
                `create`: it has no tables of the schema.
        """
        parsed = parse(url)
        where = _shown(parsed)
        try:
            engine = sa.create_engine(parsed)
        except ImportError as error:
            remedy = 'for postgresql+psycopg install it: pip install "robogauntlet[postgresql]"'
            raise StoreError(f"{where}: not installed (no module {error.name}); {remedy}") from None
        except sa.exc.SQLAlchemyError as error:
            raise StoreError(f"{where}: {error}") from None
        database = cls(engine, where)
        if parsed.get_backend_name() == "sqlite":
            sa.event.listen(engine, "connect", tune)
            if (file := database.file) and (reason := why_no_database(file, create=create)):
                raise StoreError(f"{where}: expected a {schema.what}, {reason}")
        try:
            with database.explained():
                database._prepare(schema, create)
        except BaseException:
            database.close()
            raise
        return database

    @property
    def file(self) -> Path | None:
        """The file of an SQLite database, if its URL names one plainly."""
        url = self.engine.url
        return file_of(url) if "uri" not in url.query else None

    def _prepare(self, schema: Schema, create: bool) -> None:
        existing = set(sa.inspect(self.engine).get_table_names())
        marker = schema.version_table
        is_file = self.engine.dialect.name == "sqlite"
        if is_file and existing and not any(name.startswith("robogauntlet_") for name in existing):
            raise StoreError(f"{self.where}: expected a {schema.what}, this is a database of another program")
        if is_file and (name := self._computed(schema)):
            raise StoreError(
                f"{self.where}: expected a {schema.what} of rows, its {name} is computed by somebody's SQL"
            )
        if marker.name not in existing and (others := existing & set(schema.metadata.tables)):
            raise StoreError(
                f"{self.where}: not a RoboGauntlet {schema.what}: it has a table {min(others)} of another program"
            )
        version = None
        if marker.name in existing:
            with self.engine.connect() as connection:
                version = self._version(connection, schema)
            if version == schema.version and (not create or existing >= set(schema.metadata.tables)):
                return
        if version is None and not create:
            raise StoreError(f"{self.where}: expected a {schema.what}, this database has none of its tables")
        if is_file and create:
            with self.engine.connect() as connection:
                use_write_ahead_log(connection)
        with self.explained(), self.engine.begin() as connection:
            self._complete(connection, schema)

    def _version(self, connection: sa.Connection, schema: Schema) -> int | None:
        """The version of the schema's tables, None if their creation was cut short. Raises StoreError for others."""
        version = connection.scalar(sa.select(sa.func.max(schema.version_table.c.version)))
        if version is None or schema.oldest <= version <= schema.version:
            return version
        raise StoreError(
            f"{self.where}: expected a {schema.what} of version {schema.version}, got version {version}; "
            "open it with the RoboGauntlet that wrote it, or name another"
        )

    def _complete(self, connection: sa.Connection, schema: Schema) -> None:
        """Create missing tables, columns and indexes, and write the version, all in the connection's transaction."""
        marker = schema.version_table
        self._wait_for_others(connection, marker.name)
        connection.execute(sa.schema.CreateTable(marker, if_not_exists=True))
        self._version(connection, schema)  # Another process may have created it meanwhile, in another version too.
        for table in schema.metadata.sorted_tables:
            connection.execute(sa.schema.CreateTable(table, if_not_exists=True))
            there = {column["name"] for column in sa.inspect(connection).get_columns(table.name)}
            for column in table.columns:
                if column.name not in there:
                    kind = column.type.compile(connection.dialect)
                    connection.exec_driver_sql(f"ALTER TABLE {table.name} ADD COLUMN {column.name} {kind}")
            for index in table.indexes:
                if connection.dialect.name == "postgresql":  # not in the schema, where it would load the dialect
                    index.dialect_kwargs["postgresql_where"] = index.dialect_kwargs["sqlite_where"]
                connection.execute(sa.schema.CreateIndex(index, if_not_exists=True))
        connection.execute(self.insert_new(marker).values(version=schema.version))

    def _wait_for_others(self, connection: sa.Connection, name: str) -> None:
        """Until the end of the transaction, let no other process change the tables that go by a name."""
        if connection.dialect.name == "sqlite":
            connection.exec_driver_sql("BEGIN IMMEDIATE")
        else:
            connection.exec_driver_sql(f"SET LOCAL lock_timeout = '{BUSY_S:.0f}s'")
            connection.execute(sa.select(sa.func.pg_advisory_xact_lock(sa.func.hashtext(name))))

    def _computed(self, schema: Schema) -> str | None:
        """A view in place of a table of the schema, or a trigger on one, of which people have made endless ones."""
        master = sa.table("sqlite_master", *map(sa.column, ("type", "name", "tbl_name")))
        query = sa.select(master.c.tbl_name).where(
            master.c.type.in_(["view", "trigger"]), master.c.tbl_name.in_(list(schema.metadata.tables))
        )
        with self.engine.connect() as connection:
            return connection.scalar(query.limit(1))

    def insert_new(self, table: sa.Table) -> Any:
        """An insertion that skips rows whose primary key exists."""
        return self.insert(table).on_conflict_do_nothing()

    def insert(self, table: sa.Table) -> Any:
        """An insertion of the dialect, which has clauses for conflicts."""
        if self.engine.dialect.name == "postgresql":
            from sqlalchemy.dialects import postgresql  # slow to load, and seldom used

            return postgresql.insert(table)
        return sqlite.insert(table)

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
        except (sa.exc.DataError, sa.exc.IntegrityError) as error:
            raise UnstorableValue(f"{self.where}: {str(error.orig).splitlines()[0]}") from error
        except sa.exc.DBAPIError as error:
            reason = str(error.orig).splitlines()[0]
            if "not a database" in reason:
                reason = "expected a store, this file is something else"
            if "unable to open" in reason and self.file is not None:
                reason = why_not_opened(self.file) or reason
            if "readonly database" in reason:
                reason = "expected a store in a place that can be written, which reading takes too; copy it to one"
            raise StoreError(f"{self.where}: {reason}") from error
        except sa.exc.SQLAlchemyError as error:
            raise StoreError(f"{self.where}: {str(error).splitlines()[0]}") from error
        except (OverflowError, TypeError, ValueError) as error:  # of the driver
            raise UnstorableValue(f"{self.where}: a value cannot be stored or read: {first_line(error)}") from error

    def close(self) -> None:
        """Free the connections."""
        self.engine.dispose()


def parse(url: str) -> sa.URL:
    """Parse a database URL. Raises StoreError: not a URL, or not of SQLite or PostgreSQL."""
    try:
        parsed = sa.make_url(url)
    except (sa.exc.ArgumentError, ValueError):
        shown = "" if set(url) & set("@=") else f": {url}"  # What is no URL may hold a password at any place.
        expected = "expected sqlite:///FILE or postgresql+psycopg://HOST:PORT/DATABASE, with a number as PORT"
        raise StoreError(f"not a store URL{shown}; {expected}") from None
    if parsed.get_backend_name() not in BACKENDS:
        where = _shown(parsed)
        raise StoreError(f"{where}: expected an sqlite or postgresql URL, got {parsed.get_backend_name()}")
    if parsed.get_backend_name() == "sqlite" and not _UNQUOTES:
        parsed = parsed.set(database=unquote(parsed.database or ""))
    if parsed.get_backend_name() == "sqlite" and (reason := why_no_url(parsed)):
        raise StoreError(f"{_shown(parsed)}: {reason}")
    return parsed


def _shown(url: sa.URL) -> str:
    """A URL without its secrets, in the query too, where PostgreSQL's library takes them."""
    hidden = {name: "***" for name in url.query if _SECRET.search(name)}
    return url.update_query_dict(hidden).render_as_string(hide_password=True).replace("%2A%2A%2A", "***")


def without_password(url: str) -> str:
    """Return a database URL with its passwords hidden. Raises StoreError."""
    return _shown(parse(url))


def file_url(path: Path) -> str:
    """Return the URL of an SQLite store in a file, with special characters of its name quoted."""
    return f"sqlite:///{quote(str(path))}"
