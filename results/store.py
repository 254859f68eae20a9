"""The store: SQLite in the run folder, or PostgreSQL by URL. A row is stored once however often its episode ran."""

from __future__ import annotations

import dataclasses
import json
import sqlite3
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from results.record import FIELDS, EpisodeResult, describe_fields

SCHEMA_VERSION = 3
BUSY_S = 30.0
"""Time to wait for another process that writes (s)."""
_TYPES: dict[type, Any] = {str: sa.Text, int: sa.BigInteger, float: sa.Float(53), bool: sa.Boolean}

_metadata = sa.MetaData()
_schema = sa.Table("robogauntlet_schema", _metadata, sa.Column("version", sa.Integer, primary_key=True))
_runs = sa.Table(
    "runs",
    _metadata,
    sa.Column("run_id", sa.Text, primary_key=True),
    sa.Column("started_at", sa.Float(53), nullable=False),
    sa.Column("document", sa.Text, nullable=False),
)
_episodes = sa.Table(
    "episodes",
    _metadata,
    sa.Column("run_id", sa.Text, sa.ForeignKey("runs.run_id"), primary_key=True),
    *(
        sa.Column(name, _TYPES[kind], primary_key=name == "episode_id", nullable=nullable)
        for name, (kind, nullable, _) in describe_fields().items()
    ),
)
_what_is_there = sa.Index(
    "robogauntlet_what_is_there",
    *(_episodes.c[name] for name in ("run_id", "policy_digest", "task", "axis", "severity", "seed", "status")),
)
"""Answers what a run still lacks without reading its rows."""


class StoreError(Exception):
    """The store cannot be opened, read or written; the message says why and what to do."""


class Store:
    """The rows of one run. One process writes; any number may read."""

    def __init__(self, engine: sa.Engine, run_id: str, where: str) -> None:
        self._engine = engine
        self._run_id = run_id
        self._where = where

    @classmethod
    def open(cls, url: str, run_id: str) -> Store:
        """Open the store at an SQLAlchemy URL for one run; create its tables where they are missing.

        Raises:
            StoreError: It cannot be reached, is not a store, or belongs to a newer version.
        """
        try:
            parsed = sa.make_url(url)
        except sa.exc.ArgumentError:
            raise StoreError(
                f"not a store URL: {url}; expected sqlite:///FILE or postgresql+psycopg://HOST/DATABASE"
            ) from None
        where = parsed.render_as_string(hide_password=True)
        if parsed.get_backend_name() not in ("sqlite", "postgresql"):
            raise StoreError(f"{where}: expected an sqlite or postgresql URL, got {parsed.get_backend_name()}")
        try:
            engine = sa.create_engine(parsed)
        except (ImportError, sa.exc.SQLAlchemyError) as error:
            raise StoreError(f"{where}: {error}") from None
        if parsed.get_backend_name() == "sqlite":
            sa.event.listen(engine, "connect", _tune_sqlite)
        store = cls(engine, run_id, where)
        with store._explained():
            store._prepare()
        return store

    @classmethod
    def open_file(cls, path: Path, run_id: str) -> Store:
        """Open an SQLite store in a file. Raises StoreError."""
        if path.is_dir():
            raise StoreError(f"{path}: expected a store file, this is a directory")
        return cls.open(file_url(path), run_id)

    def _prepare(self) -> None:
        existing = set(sa.inspect(self._engine).get_table_names())
        ours = set(_metadata.tables)
        if existing & ours and _schema.name not in existing:
            raise StoreError(
                f"{self._where}: not a RoboGauntlet store: it has a table {min(existing & ours)} of another program"
            )
        if _schema.name in existing:
            with self._engine.connect() as connection:
                version = connection.scalar(sa.select(sa.func.max(_schema.c.version)))
            if version == SCHEMA_VERSION:
                return
            if version is not None:
                raise StoreError(f"{self._where}: store version {version}, this program reads version {SCHEMA_VERSION}")
        # Another process may be creating the store right now, or was killed between two tables: SQLite commits each.
        with self._engine.begin() as connection:
            for table in _metadata.sorted_tables:
                connection.execute(sa.schema.CreateTable(table, if_not_exists=True))
            connection.execute(self._insert(_schema).values(version=SCHEMA_VERSION))

    def begin_run(self, document: dict[str, Any]) -> None:
        """Record the run itself, unless it is there already."""
        with self._explained(), self._engine.begin() as connection:
            connection.execute(sa.schema.CreateIndex(_what_is_there, if_not_exists=True))
            row = {"run_id": self._run_id, "started_at": time.time(), "document": json.dumps(document)}
            connection.execute(self._insert(_runs), [row])

    def add(self, results: Sequence[EpisodeResult]) -> int:
        """Store rows that are not there yet, in one transaction; return how many were new.

        Raises:
            StoreError: The disk is full, the folder is read-only, the server is gone. Nothing of the batch is stored.
        """
        if not results:
            return 0
        rows = [{"run_id": self._run_id, **{name: getattr(r, name) for name in FIELDS}} for r in results]
        with self._explained(), self._engine.begin() as connection:
            # Counted by what comes back: drivers do not agree on the row count of many inserts at once.
            statement = self._insert(_episodes).returning(_episodes.c.episode_id)
            return len(connection.execute(statement, rows).all())

    def outcomes(self) -> dict[tuple[str, str, str, int], dict[int, str]]:
        """Status of each stored seed by (policy digest, task, axis, severity)."""
        e = _episodes.c
        columns = (e.policy_digest, e.task, e.axis, e.severity, e.seed, e.status)
        query = sa.select(*columns).where(e.run_id == self._run_id)
        found: dict[tuple[str, str, str, int], dict[int, str]] = {}
        with self._explained(), self._engine.connect() as connection:
            for row in connection.execution_options(yield_per=10_000).execute(query):
                found.setdefault((row[0], row[1], row[2], row[3]), {})[row[4]] = row[5]
        return found

    def status_counts(self) -> dict[tuple[str, str], int]:
        """Stored rows by (simulator, status)."""
        e = _episodes.c
        query = sa.select(e.task, e.status, sa.func.count()).where(e.run_id == self._run_id).group_by(e.task, e.status)
        counts: Counter[tuple[str, str]] = Counter()
        with self._explained(), self._engine.connect() as connection:
            for task, status, count in connection.execute(query):
                counts[task.partition("/")[0], status] += count
        return dict(counts)

    def results(self) -> Iterator[EpisodeResult]:
        """Every row, ordered by simulator, task, policy, condition and seed."""
        for batch in self.batches():
            for row in batch:
                yield EpisodeResult(**dict(zip(FIELDS, row, strict=True)))

    def batches(self, size: int = 10_000, fields: Sequence[str] = FIELDS) -> Iterator[Sequence[Sequence[Any]]]:
        """These fields of the rows of `results` as plain values, at most `size` at a time."""
        e = _episodes.c
        query = (
            sa.select(*(e[name] for name in fields))
            .where(e.run_id == self._run_id)
            .order_by(e.simulator, e.task, e.policy, e.axis, e.severity, e.seed, e.episode_id)
        )
        with self._explained(), self._engine.connect() as connection:
            yield from connection.execution_options(yield_per=size).execute(query).partitions()

    def find(self, episode_id: str) -> EpisodeResult | None:
        """The row of that id, or of the one id that starts like it."""
        e = _episodes.c
        query = (
            sa.select(*(e[name] for name in FIELDS))
            .where(e.run_id == self._run_id, e.episode_id.startswith(episode_id, autoescape=True))
            .limit(2)
        )
        with self._explained(), self._engine.connect() as connection:
            rows = connection.execute(query).all()
        if len(rows) > 1:
            raise StoreError(f"{episode_id}: more than one episode id starts like this; give more digits")
        return EpisodeResult(**dict(zip(FIELDS, rows[0], strict=True))) if rows else None

    def forget_errors(self) -> int:
        """Remove error rows, so that the run does them again; return how many."""
        e = _episodes.c
        with self._explained(), self._engine.begin() as connection:
            statement = sa.delete(_episodes).where(e.run_id == self._run_id, e.status == "error")
            return int(connection.execute(statement).rowcount)

    def close(self) -> None:
        """Free the connections."""
        self._engine.dispose()

    def _insert(self, table: sa.Table) -> Any:
        dialect = postgresql if self._engine.dialect.name == "postgresql" else sqlite
        return dialect.insert(table).on_conflict_do_nothing()

    def _explained(self) -> _Explained:
        return _Explained(self._where)


def file_url(path: Path) -> str:
    """URL of an SQLite store in a file, whatever characters its name has."""
    return f"sqlite:///{quote(str(path))}"


@dataclasses.dataclass
class _Explained:
    """Turns database errors into a StoreError of one line."""

    where: str

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, sa.exc.DBAPIError):
            reason = str(error.orig).splitlines()[0]
            if "not a database" in reason:
                reason = "expected a store, this file is something else"
            raise StoreError(f"{self.where}: {reason}") from error
        if isinstance(error, sa.exc.SQLAlchemyError):
            raise StoreError(f"{self.where}: {str(error).splitlines()[0]}") from error


def _tune_sqlite(connection: sqlite3.Connection, _record: Any) -> None:
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout={int(1000 * BUSY_S)}")
    deadline = time.monotonic() + BUSY_S
    while True:
        try:
            cursor.execute("PRAGMA journal_mode=WAL")
            break
        except sqlite3.OperationalError as error:
            # SQLite does not wait for its lock here, whatever the time-out: another process is opening the store too.
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(0.01)
    cursor.execute("PRAGMA synchronous=NORMAL")
    cursor.close()
