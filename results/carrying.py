"""A run as one file: a store that holds this run alone, with its document. Taken out of one place, put into another."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

from results.database import StoreError, file_url, without_password
from results.history import History
from results.record import EpisodeResult, outcome_row, rows_hash
from results.run import STORE_FILE, RunDocument, RunError, write_run
from results.store import Store

BATCH = 10_000
MAGIC = b"SQLite format 3\0"


def export_run(document: RunDocument, rows: Store, file: Path) -> int:
    """Write a run into a new file. A crash leaves no file.

    Args:
        document: The run.
        rows: Its rows.
        file: Where to; must not exist.

    Returns:
        The number of rows.

    Raises:
        RunError: The file is there already.
        StoreError: Rows cannot be read or written.
        OSError: The file cannot be written.
    """
    if file.exists():
        raise RunError(f"{file}: expected a new file, there is one already")
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        copy = Store.open_file(temporary, document.run_id)
        try:
            count = _copy(document.model_copy(update={"store_url": None}), rows, copy)
        finally:
            copy.close()
        with sqlite3.connect(temporary) as connection:
            connection.execute("PRAGMA journal_mode=DELETE")  # one file, nothing beside it
        connection.close()
        temporary.replace(file)
    finally:
        for path in file.parent.glob(f"{temporary.name}*"):
            path.unlink()
    return count


def import_run(
    file: Path,
    root: Path,
    *,
    store: str | None = None,
    name: str | None = None,
    check: Callable[[RunDocument], None] | None = None,
) -> tuple[Path, RunDocument]:
    """Make a run folder of an exported run.

    Args:
        file: As `export_run` wrote it; whoever made it is not trusted.
        root: Folder of runs, where the new one goes.
        store: URL of a store for its rows, or None for a file in the folder.
        name: Of the new folder; None for the suite's name and the beginning of the run's id.
        check: Called with the document before anything is put in its place; raises RunError to refuse it.

    Returns:
        The folder and the document.

    Raises:
        RunError: It is no exported run, its rows are not those that it had, or the folder is there already.
        StoreError: It cannot be read, or is of a newer version; or the store cannot be written.
        OSError: The folder cannot be written.
    """
    _check_file(file)
    root.mkdir(parents=True, exist_ok=True)
    arriving = root / f".arriving-{os.getpid()}-{file.name[:40]}"
    shutil.rmtree(arriving, ignore_errors=True)
    arriving.mkdir()
    try:
        shutil.copyfile(file, arriving / STORE_FILE)  # opening migrates: the file that was given stays as it is
        document = _document_of(arriving / STORE_FILE, file)
        if check is not None:
            check(document)
        folder = root / (name or f"{_plain(document.suite_name)}-{_plain(document.run_id)[:8]}")
        if folder.exists():
            raise RunError(f"{folder}: expected a new folder, there is one already; name another with --out")
        rows = Store.open_file(arriving / STORE_FILE, document.run_id)
        try:
            found = rows_hash(map(outcome_row, rows.results()))
            if document.rows_hash is not None and found != document.rows_hash:
                raise RunError(f"{file}: its rows hash to {found}, the run had {document.rows_hash}: it was changed")
            if store is not None:
                document = document.model_copy(update={"store_url": without_password(store)})
                there = Store.open(store, document.run_id)
                try:
                    _copy(document, rows, there)
                finally:
                    there.close()
        finally:
            rows.close()
        if store is not None:
            for path in arriving.glob(f"{STORE_FILE}*"):
                path.unlink()
        write_run(arriving, document)
        arriving.rename(folder)
        return folder, document
    finally:
        shutil.rmtree(arriving, ignore_errors=True)


def _copy(document: RunDocument, rows: Store, there: Store) -> int:
    history = History(there.database)
    history.record(document)
    results: Iterator[EpisodeResult] = iter(rows.results())
    count = 0
    while batch := list(islice(results, BATCH)):
        count += there.add(batch)
    history.record(document, counted=history.counted(document.run_id))
    return count


def _check_file(file: Path) -> None:
    try:
        with file.open("rb") as opened:
            start = opened.read(len(MAGIC))
    except OSError as error:
        raise RunError(f"{file}: expected an exported run: {error.strerror}") from None
    if start != MAGIC:
        raise RunError(f"{file}: expected an exported run (`gauntlet export`), this is something else")


def _document_of(copy: Path, file: Path) -> RunDocument:
    try:
        history = History.open(file_url(copy))
    except StoreError as error:
        raise StoreError(str(error).replace(str(copy), str(file))) from None
    try:
        entries = history.runs(limit=2)
        if len(entries) != 1:
            raise RunError(f"{file}: expected one exported run, got {'several' if entries else 'none'}")
        document = history.document(entries[0].run_id)
    except StoreError as error:
        raise RunError(f"{file}: expected an exported run: {str(error).partition(': ')[2]}") from None
    finally:
        history.close()
    return document


def _plain(text: str) -> str:
    """Letters, digits, dashes and underscores: what a folder may safely be called, whatever a file says."""
    return "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in text)[:60] or "run"
