"""The rows of a run, in SQLite in the run folder or in PostgreSQL by URL. Each episode has one row."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from robogauntlet.results.record import FIELDS, EpisodeResult, rows_hash
from robogauntlet.results.run_document import STORE_FILE, RunDocument, store_url
from robogauntlet.results.store.database import Database, StoreError, file_url, parse, without_password
from robogauntlet.results.store.schema import SCHEMA, episodes, runs
from robogauntlet.results.store.sqlite_file import file_of

__all__ = ["Store", "StoreError", "file_url"]


def check_place(folder: Path, url: str) -> None:
    """Raise StoreError if the store at `url` would take the place of another file of a run folder."""
    file = file_of(parse(url))
    if file is None:
        return
    file, folder = file.absolute().resolve(), folder.absolute().resolve()
    if folder in (file, *file.parents) and file != folder / STORE_FILE:
        raise StoreError(
            f"{without_password(url)}: expected a store outside of the run folder {folder}, or its {STORE_FILE}, which "
            "is taken without --store"
        )


class Store:
    """The rows of one run. One process may write, any number may read."""

    def __init__(self, database: Database, run_id: str) -> None:
        """See `open`."""
        self.database = database
        self._run_id = run_id

    @classmethod
    def open(cls, url: str, run_id: str, *, create: bool = True) -> Store:
        """Open the store at an SQLAlchemy URL for one run; create missing tables unless `create` is false.

        On PostgreSQL, `History.record` has to record the run before rows are added.

        Raises:
            StoreError: It cannot be reached, is not a store, or has another version.
        """
        return cls(Database.open(url, SCHEMA, create=create), run_id)

    @classmethod
    def open_begun(cls, folder: Path, document: RunDocument, url: str | None = None) -> Store:
        """Open the existing store of a run: that at `url`, or the file in the run folder. Creates nothing.

        Raises:
            RunError: The rows are in a database whose URL was not given.
            StoreError: As `open`; or it does not exist, has other runs only, or has lost the rows of an ended run.
        """
        address = store_url(folder, document, url)
        file = file_of(parse(address))
        if file is not None and not file.exists():
            raise StoreError(f"{file}: expected the store of the run in {folder}, there is no such file")
        store = cls.open(address, document.run_id, create=False)
        lack = None
        if url is not None and not store.knows_run():
            lack = f"expected the store of the run in {folder}, it has nothing of this run"
        elif document.rows_hash not in (None, rows_hash(())) and not store.has_rows():
            lack = f"expected the rows of the run in {folder}, it has none; restore it from a copy"
        if lack is not None:
            store.close()
            raise StoreError(f"{store.database.where}: {lack}")
        return store

    @property
    def file(self) -> Path | None:
        """The file with the rows; None if they are on a server."""
        return file_of(self.database.engine.url)

    def save_copy(self, file: Path) -> None:
        """Copy the whole store, if it is a file, into a new one, also after its name has gone. Raises StoreError."""
        with self.database.reading() as connection:
            connection.exec_driver_sql("VACUUM INTO ?", (str(file),))

    @classmethod
    def open_file(cls, path: Path, run_id: str) -> Store:
        """Open an SQLite store in a file. Raises StoreError."""
        return cls.open(file_url(path), run_id)

    def knows_run(self) -> bool:
        """Whether the store has the run or rows of it. Raises StoreError."""
        with self.database.reading() as connection:
            queries = (sa.select(table.c.run_id).where(table.c.run_id == self._run_id) for table in (runs, episodes))
            return any(connection.scalar(query.limit(1)) is not None for query in queries)

    def has_rows(self, *where: sa.ColumnElement[bool]) -> bool:
        """Whether the store has a row of the run for which all of `where` holds. Raises StoreError."""
        query = sa.select(episodes.c.run_id).where(episodes.c.run_id == self._run_id, *where).limit(1)
        with self.database.reading() as connection:
            return connection.scalar(query) is not None

    def add(self, results: Sequence[EpisodeResult]) -> int:
        """Store rows in one transaction, skipping known episodes; return the number of new rows.

        Raises:
            StoreError: The disk is full, the folder is read-only, the server is gone. No row is stored.
        """
        if not results:
            return 0
        rows = [{"run_id": self._run_id, **{name: getattr(r, name) for name in FIELDS}} for r in results]
        with self.database.writing() as connection:
            # Count the returned ids: drivers disagree on the row count of many inserts.
            statement = self.database.insert_new(episodes).returning(episodes.c.episode_id)
            return len(connection.execute(statement, rows).all())

    def outcomes(self) -> dict[tuple[str, str, str, int], dict[int, str]]:
        """Status of each stored seed by (policy digest, task, axis, severity)."""
        e = episodes.c
        columns = (e.policy_digest, e.task, e.axis, e.severity, e.seed, e.status)
        query = sa.select(*columns).where(e.run_id == self._run_id)
        found: dict[tuple[str, str, str, int], dict[int, str]] = {}
        with self.database.reading() as connection:
            for row in connection.execution_options(yield_per=10_000).execute(query):
                found.setdefault((row[0], row[1], row[2], row[3]), {})[row[4]] = row[5]
        return found

    def results(self) -> Iterator[EpisodeResult]:
        """Every row, ordered by simulator, task, policy, condition and seed."""
        for batch in self.batches():
            for row in batch:
                yield EpisodeResult(**dict(zip(FIELDS, row, strict=True)))

    def batches(
        self, size: int = 10_000, fields: Sequence[str] = FIELDS, *where: sa.ColumnElement[bool]
    ) -> Iterator[Sequence[Sequence[Any]]]:
        """These fields of the `results` for which all of `where` holds, as plain values, at most `size` at a time."""
        e = episodes.c
        order = (e.simulator, e.task, e.policy, e.axis, e.severity, e.seed, e.episode_id)
        with self.database.reading() as connection:
            query = self._select(connection, *(e[name] for name in fields)).where(*where).order_by(*order)
            yield from connection.execution_options(yield_per=size).execute(query).partitions()

    def start_states(self) -> dict[str, str]:
        """Pair to the state that its episodes without an error start from, of several the first policy's."""
        e = episodes.c
        with self.database.reading() as connection:
            query = self._select(connection, e.pair_id, e.state_hash, sa.func.min(e.policy)).where(e.status != "error")
            found = connection.execute(query.group_by(e.pair_id, e.state_hash)).all()
        return {pair: state for pair, state, _ in sorted(found, key=lambda one: str(one[2]), reverse=True)}

    def _select(self, connection: sa.Connection, *columns: sa.ColumnElement[Any]) -> sa.Select[Any]:
        """A query of the rows. A file without others is read as it lies: few fields take half the time of an index."""
        own: sa.ColumnElement[str] = episodes.c.run_id
        if connection.dialect.name == "sqlite":
            ends = (connection.scalar(sa.select(end(own))) for end in (sa.func.min, sa.func.max))
            if {*ends} == {self._run_id}:
                own = sa.literal_column("+episodes.run_id", sa.Text)  # a term that no index has
        return sa.select(*columns).where(own == self._run_id)

    def find(self, episode_id: str) -> EpisodeResult | None:
        """The row with this id, or with the only id that starts with it. Raises StoreError."""
        e = episodes.c
        query = sa.select(*(e[name] for name in FIELDS)).where(e.run_id == self._run_id).limit(2)
        query = query.where(e.episode_id.startswith(episode_id, autoescape=True))
        with self.database.reading() as connection:
            rows = connection.execute(query).all()
        if len(rows) > 1:
            raise StoreError(f"{episode_id}: more than one episode id starts like this; give more digits")
        return EpisodeResult(**dict(zip(FIELDS, rows[0], strict=True))) if rows else None

    def forget_errors(self) -> int:
        """Remove error rows, so that their episodes are played again; return their number."""
        e = episodes.c
        with self.database.writing() as connection:
            statement = sa.delete(episodes).where(e.run_id == self._run_id, e.status == "error")
            return int(connection.execute(statement).rowcount)

    def close(self) -> None:
        """Free the connections."""
        self.database.close()
