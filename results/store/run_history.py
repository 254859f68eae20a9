"""The history of runs in a store: their documents, counts and verdicts, and results of a policy by run."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from pydantic import ValidationError

from robogauntlet.results.live_status import LiveStatus
from robogauntlet.results.run_document import RunDocument, RunError, parse_run
from robogauntlet.results.store.database import Database, file_url, parse
from robogauntlet.results.store.history_records import GOOD, CellCounts, CellKey, Counts, PolicyRunResult, RunEntry
from robogauntlet.results.store.schema import (
    SCHEMA,
    cells,
    counted_cells,
    episodes,
    forgotten_runs,
    imported_runs,
    runs,
)

HISTORY_FILE = "history.sqlite"
ENTRY_COLUMNS = (
    *("run_id", "suite", "status", "started_at", "finished_at", "folder", "rows_url"),
    *("verdict", "baseline", "schedule"),
)
"""Columns of `runs` that an entry has as they are."""
SHORTEST_ID = 8
"""Characters of a run's id that name it; fewer might name another one by mistake."""
NEWEST = 500
"""Runs of a suite that `newest_runs` returns at most."""


def history_url(url: str | None, root: Path) -> str:
    """Return the URL of the history: the given one, which must be valid, or that of the file beside the run folders.

    Raises:
        StoreError: Not a URL, or not of SQLite or PostgreSQL.
    """
    if url is None:
        return file_url((root / HISTORY_FILE).absolute())
    return parse(url).render_as_string(hide_password=False)


class History:
    """The runs of a store. Any number of processes may read and write."""

    def __init__(self, database: Database) -> None:
        """See `open`."""
        self.database = database

    @classmethod
    def open(cls, url: str) -> History:
        """Open the store at an SQLAlchemy URL; create its tables where they are missing.

        Raises:
            StoreError: It cannot be reached, is not a store, or is of another version.
        """
        return cls(Database.open(url, SCHEMA))

    def close(self) -> None:
        """Free the connections."""
        self.database.close()

    # Writing

    def record(
        self,
        document: RunDocument,
        folder: Path | None = None,
        counted: Mapping[CellKey, Counts] | None = None,
        schedule: str | None = None,
        *,
        imported: bool = False,
    ) -> None:
        """Write or update a run, also one that was forgotten. Raises StoreError.

        A run that was accepted as a baseline is so only as long as it has the same rows.

        Args:
            document: The run.
            folder: Its folder; None keeps the stored one.
            counted: Counts of its cells; missing cells of the plan count as not played. None keeps the stored counts.
            schedule: The schedule that started it; None keeps the stored one.
            imported: Whether its rows are the word of others, as those of every document with that origin.
        """
        values: dict[str, Any] = {
            "started_at": document.started_at,
            "document": document.model_dump_json(),
            "suite": document.suite.name,
            "status": str(document.status),
            "finished_at": document.finished_at,
            "planned": document.planned,
            "rows_url": document.store_url,
            "live": None,
        }
        if folder is not None:
            values["folder"] = str(folder.absolute())
        if schedule is not None:
            values["schedule"] = schedule
        rows = [{"run_id": document.run_id, **row} for row in _cell_rows(document, counted or {})]
        with self.database.writing() as connection:
            same = runs.c.run_id == document.run_id
            before = connection.scalar(sa.select(runs.c.document).where(same, runs.c.accepted.is_(True)))
            if before is not None and _rows_hash(before) != document.rows_hash:
                values["accepted"] = False
            statement = self.database.insert(runs).values(run_id=document.run_id, **values)
            connection.execute(statement.on_conflict_do_update(index_elements=["run_id"], set_=values))
            if counted is not None:
                connection.execute(sa.delete(cells).where(cells.c.run_id == document.run_id))
            if rows:
                connection.execute(self.database.insert_new(cells), rows)
            if imported or document.origin == "imported":
                connection.execute(self.database.insert_new(imported_runs).values(run_id=document.run_id))
            connection.execute(sa.delete(forgotten_runs).where(forgotten_runs.c.run_id == document.run_id))

    def forget(self, run_id: str, folder: str | None) -> int:
        """Remove a run with its rows, if they are here. Scans do not record it again from `folder`. Raises StoreError.

        Returns the number of removed rows.
        """
        removed = self.remove(run_id)
        with self.database.writing() as connection:
            entry = self.database.insert(forgotten_runs).values(run_id=run_id, folder=folder)
            connection.execute(entry.on_conflict_do_update(index_elements=["run_id"], set_={"folder": folder}))
        return removed

    def remove(self, run_id: str) -> int:
        """Remove a run, and its rows if they are here; return their number. Raises StoreError."""
        with self.database.writing() as connection:
            removed = connection.execute(sa.delete(episodes).where(episodes.c.run_id == run_id)).rowcount
            for table in (cells, imported_runs, runs):
                connection.execute(sa.delete(table).where(table.c.run_id == run_id))
        return int(removed)

    def write_live_status(self, run_id: str, live: LiveStatus) -> None:
        """Write the live status of a run. Raises StoreError."""
        self._change(run_id, live=live.model_dump_json())

    def write_verdict(self, run_id: str, verdict: str, baseline: str | None, reasons: Sequence[str]) -> None:
        """Write the verdict of a comparison with a baseline. Raises StoreError."""
        self._change(run_id, verdict=verdict, baseline=baseline, reasons="\n".join(reasons))

    def accept(self, run_id: str) -> None:
        """Accept a run with its present rows as the baseline of later ones, whatever its verdict. Raises StoreError."""
        self._change(run_id, accepted=True)

    def clear_folder(self, run_id: str) -> None:
        """Record that a run's folder was removed; its counts stay. Raises StoreError."""
        self._change(run_id, folder=None)

    def _change(self, run_id: str, **values: Any) -> None:
        with self.database.writing() as connection:
            connection.execute(sa.update(runs).where(runs.c.run_id == run_id).values(**values))

    # Reading

    def count_cells(self, run_id: str) -> dict[CellKey, Counts]:
        """Counts of a run's cells, from the episodes in this store. Raises StoreError."""
        with self.database.reading() as connection:
            found = connection.execute(counted_cells().where(episodes.c.run_id == run_id)).all()
        return {(r.policy_digest, r.task, r.axis, r.severity): Counts(0, r[-3], r[-2], r[-1]) for r in found}

    def runs(self, *, suite: str | None = None, status: str | None = None, limit: int | None = None) -> list[RunEntry]:
        """Runs, the newest first. Raises StoreError."""
        query = _filtered(sa.select(runs.c.run_id), suite, status)
        return self.entries(query.order_by(runs.c.started_at.desc(), runs.c.run_id).limit(limit))

    def entries(self, ids: sa.Select[tuple[str]] | Sequence[str]) -> list[RunEntry]:
        """The runs with these ids, or the ids that a query selects, newest first. Raises StoreError."""
        columns = [column for column in runs.c if column.name not in ("document", "planned")]
        names = ("planned", "successes", "failures", "errors")
        sums = [sa.func.coalesce(sa.func.sum(cells.c[name]), 0).label(name) for name in names]
        policies = sa.func.count(sa.distinct(cells.c.policy_digest)).label("policies")
        imported = runs.c.run_id.in_(sa.select(imported_runs.c.run_id)).label("imported")
        query = sa.select(*columns, *sums, policies, imported).outerjoin(cells, cells.c.run_id == runs.c.run_id)
        query = query.where(runs.c.run_id.in_(ids)).group_by(*columns)
        with self.database.reading() as connection:
            return list(map(_entry, connection.execute(query.order_by(runs.c.started_at.desc(), runs.c.run_id))))

    def newest_runs(self, suite: str, *, imported: bool = False) -> list[tuple[RunEntry, dict[str, str]]]:
        """The newest complete runs of a suite, with digests by policy name; with `imported` also those of others.

        Raises:
            StoreError: The store cannot be read.
        """
        newest = _filtered(sa.select(runs.c.run_id), suite, "complete")
        newest = newest if imported else newest.where(runs.c.run_id.not_in(sa.select(imported_runs.c.run_id)))
        newest = newest.order_by(runs.c.started_at.desc()).limit(NEWEST)
        query = sa.select(cells.c.run_id, cells.c.policy, cells.c.policy_digest).where(cells.c.run_id.in_(newest))
        digests: dict[str, dict[str, str]] = {}
        with self.database.reading() as connection:
            for run_id, policy, digest in connection.execute(query.distinct()):
                digests.setdefault(run_id, {})[policy] = digest
        return [(entry, digests[entry.run_id]) for entry in self.entries(newest) if entry.run_id in digests]

    def find(self, name: str) -> RunEntry | None:
        """The run with this id, else the newest in a folder of this name, else the newest whose id starts like it.

        Runs that were played here come before those of others.
        A beginning of an id has `SHORTEST_ID` characters or more. Raises StoreError.
        """
        if not name:
            return None
        called = runs.c.folder.endswith(f"/{name}", autoescape=True)
        begins = runs.c.run_id.startswith(name, autoescape=True) if len(name) >= SHORTEST_ID else runs.c.run_id == name
        clause = sa.or_(called, begins)
        rank = sa.case((runs.c.run_id == name, 0), (called, 1), else_=2)
        of_others = runs.c.run_id.in_(sa.select(imported_runs.c.run_id))
        newest = sa.select(runs.c.run_id).where(clause).order_by(rank, of_others, runs.c.started_at.desc()).limit(1)
        return next(iter(self.entries(newest)), None)

    def document(self, run_id: str) -> RunDocument:
        """The document of a run.

        Raises:
            RunError: The run is not in the store, or its document has another format.
            StoreError: The store cannot be read.
        """
        with self.database.reading() as connection:
            text = connection.scalar(sa.select(runs.c.document).where(runs.c.run_id == run_id))
        if text is None:
            raise RunError(f"{self.database.where}: expected run {run_id}, it is not there")
        return parse_run(text, f"{self.database.where}: run {run_id}")

    def cells(self, run_id: str) -> list[CellCounts]:
        """Counts of a run's cells, ordered by task, policy and condition. Raises StoreError."""
        query = sa.select(cells).where(cells.c.run_id == run_id)
        query = query.order_by(cells.c.task, cells.c.policy, cells.c.axis, cells.c.severity)
        with self.database.reading() as connection:
            return [
                CellCounts(r.policy, r.policy_digest, r.task, r.axis, r.severity, _counts(r))
                for r in connection.execute(query)
            ]

    def suites(self) -> dict[str, int]:
        """Suite to its number of runs. Raises StoreError."""
        query = sa.select(runs.c.suite, sa.func.count()).group_by(runs.c.suite)
        with self.database.reading() as connection:
            return {row[0]: row[1] for row in connection.execute(query.order_by(runs.c.suite))}

    def policies(self, suite: str | None = None) -> list[str]:
        """Names of all policies, or of those that a suite played. Raises StoreError."""
        query = sa.select(cells.c.policy).distinct().order_by(cells.c.policy)
        if suite is not None:
            query = query.join(runs, runs.c.run_id == cells.c.run_id).where(runs.c.suite == suite)
        with self.database.reading() as connection:
            return list(connection.scalars(query))

    def policy_history(
        self, policy: str, *, suite: str | None = None, task: str | None = None, limit: int = 200
    ) -> list[PolicyRunResult]:
        """Results of a policy under the clean condition in its newest runs, oldest run first. Raises StoreError."""
        has_policy = sa.exists().where(cells.c.run_id == runs.c.run_id, cells.c.policy == policy)
        newest = sa.select(runs.c.run_id).where(has_policy)
        newest = _filtered(newest, suite, None).order_by(runs.c.started_at.desc()).limit(limit)
        sums = [sa.func.sum(cells.c[name]).label(name) for name in ("planned", "successes", "failures", "errors")]
        query = sa.select(cells.c.run_id, cells.c.policy_digest, *sums)
        query = query.where(cells.c.run_id.in_(newest), cells.c.policy == policy, cells.c.severity == 0)
        if task is not None:
            query = query.where(cells.c.task == task)
        with self.database.reading() as connection:
            found = connection.execute(query.group_by(cells.c.run_id, cells.c.policy_digest)).all()
        entries = {entry.run_id: entry for entry in self.entries([row.run_id for row in found])}
        results = [PolicyRunResult(entries[row.run_id], policy, row.policy_digest, _counts(row)) for row in found]
        return sorted(results, key=lambda result: (result.run.started_at, result.run.run_id))

    def baseline(self, document: RunDocument) -> RunEntry | None:
        """The baseline of a run: the last good run of its suite that started before it and counts success alike.

        A run is good if it is complete, its rows are not the word of others, and it was accepted or its verdict is none
        or one of `GOOD`.

        Raises:
            RunError: The document of a run has another format.
            StoreError: The store cannot be read.
        """
        imported = runs.c.run_id.in_(sa.select(imported_runs.c.run_id))
        clause = sa.and_(
            runs.c.suite == document.suite.name,
            runs.c.started_at < document.started_at,
            runs.c.run_id != document.run_id,
            runs.c.status == "complete",
            ~imported,
            sa.or_(runs.c.accepted.is_(True), runs.c.verdict.is_(None), runs.c.verdict.in_(GOOD)),
        )
        good = sa.select(runs.c.run_id).where(clause).order_by(runs.c.started_at.desc()).limit(NEWEST)
        rule = document.suite.success_rule
        with self.database.reading() as connection:
            ids = connection.scalars(good).all()
        alike = (run_id for run_id in ids if self.document(run_id).suite.success_rule is rule)
        return next(iter(self.entries([*islice(alike, 1)])), None)

    def knows(self, run_id: str) -> bool:
        """Whether the run is here. Raises StoreError."""
        with self.database.reading() as connection:
            return connection.scalar(sa.select(runs.c.run_id).where(runs.c.run_id == run_id)) is not None

    def folders(self) -> dict[str, tuple[str, str]]:
        """Folder to (run id, status) of all runs that have one. Raises StoreError."""
        query = sa.select(runs.c.folder, runs.c.run_id, runs.c.status).where(runs.c.folder.is_not(None))
        with self.database.reading() as connection:
            return {folder: (run_id, status) for folder, run_id, status in connection.execute(query)}

    def forgotten_folders(self) -> dict[str, str]:
        """Folder to the id of the forgotten run in it. Raises StoreError."""
        query = sa.select(forgotten_runs.c.folder, forgotten_runs.c.run_id)
        with self.database.reading() as connection:
            return {row[0]: row[1] for row in connection.execute(query.where(forgotten_runs.c.folder.is_not(None)))}

    @property
    def url(self) -> str:
        """URL of the store with its password, which must not be shown."""
        return self.database.engine.url.render_as_string(hide_password=False)


def _rows_hash(text: str) -> str | None:
    """The hash of the rows in a stored document; None if another version wrote it."""
    with contextlib.suppress(RunError):
        return parse_run(text, "a stored run").rows_hash
    return None


def _filtered(query: Any, suite: str | None, status: str | None) -> Any:
    if suite is not None:
        query = query.where(runs.c.suite == suite)
    return query if status is None else query.where(runs.c.status == status)


def _cell_rows(document: RunDocument, counted: Mapping[CellKey, Counts]) -> Iterator[Mapping[str, Any]]:
    for cell in document.plan:
        counts = counted.get((cell.policy_digest, cell.task, cell.axis, cell.severity), Counts())
        yield asdict(counts) | cell.model_dump(exclude={"simulator"})


def _counts(row: Any) -> Counts:
    return Counts(int(row.planned), int(row.successes), int(row.failures), int(row.errors))


def _entry(row: Any) -> RunEntry:
    values = {name: getattr(row, name) for name in ENTRY_COLUMNS}
    reasons = tuple((row.reasons or "").splitlines())
    counts, live = _counts(row), _live(row.live)
    flags = {"accepted": bool(row.accepted), "policies": row.policies, "imported": bool(row.imported)}
    return RunEntry(**values, counts=counts, reasons=reasons, live=live, **flags)


def _live(text: str | None) -> LiveStatus | None:
    """The live status of a run, or None if another version wrote it."""
    try:
        return LiveStatus.model_validate_json(text) if text else None
    except ValidationError:
        return None
