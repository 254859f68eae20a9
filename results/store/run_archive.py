"""Export and import of a run as one file: a store with only this run and its document."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from itertools import islice
from pathlib import Path

from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import STORE_FILE, RunDocument, RunError, write_run
from robogauntlet.results.store.database import StoreError, file_url, without_password
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.run_history import History

BATCH = 10_000
MAGIC = b"SQLite format 3\0"


def export_run(document: RunDocument, rows: Store, file: Path) -> int:
    """Write a run into a new file and return the number of rows. A crash leaves no file.

    Raises:
        RunError: The file exists.
        StoreError: Rows cannot be read or written.
        OSError: The file cannot be written.
    """
    if file.exists():
        raise RunError(f"{file}: expected a new file, there is one already")
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        with closing(Store.open_file(temporary, document.run_id)) as copy:
            count = _copy(document.model_copy(update={"store_url": None}), rows, copy)
        with sqlite3.connect(temporary) as connection:
            connection.execute("PRAGMA journal_mode=DELETE")  # One file without a log beside it.
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
    """Create a run folder from an exported run; return it and the document, whose origin is `imported`.

    Args:
        file: The exported run, from an untrusted source.
        root: Parent of the new folder.
        store: URL of a store for its rows, or None for a file in the folder.
        name: Name of the new folder; None for the suite's name and the start of the run's id.
        check: Called with the document before the folder is created; raises RunError to refuse it.

    Raises:
        RunError: It is no exported run, its rows were changed, or the folder exists.
        StoreError: It cannot be read, or has another version; or the store cannot be written.
        OSError: The folder cannot be written.
    """
    _check_file(file)
    root.mkdir(parents=True, exist_ok=True)
    arriving = root / f".arriving-{os.getpid()}-{file.name[:40]}"
    shutil.rmtree(arriving, ignore_errors=True)
    arriving.mkdir()
    try:
        copy = arriving / STORE_FILE
        shutil.copyfile(file, copy)  # Opening a store may write into it.
        try:
            with closing(History.open(file_url(copy))) as history:
                document = _only_run(history)
                if check is not None:
                    check(document)
                folder = root / (name or f"{document.suite.name}-{_plain(document.run_id)[:8]}")
                if folder.exists():
                    raise RunError(f"{folder}: expected a new folder, there is one already; name another with --out")
                rows = Store(history.database, document.run_id)
                found = rows_hash(map(outcome_row, rows.results()))
                if document.rows_hash is not None and found != document.rows_hash:
                    raise RunError(f"{file}: its rows hash to {found}, not {document.rows_hash}: it was changed")
                url = None if store is None else without_password(store)
                document = document.model_copy(update={"origin": "imported", "command": None, "store_url": url})
                if store is not None:
                    with closing(Store.open(store, document.run_id)) as there:
                        _copy(document, rows, there)
        except (RunError, StoreError) as error:
            raise type(error)(str(error).replace(str(copy), str(file))) from None
        if store is not None:
            copy.unlink()
        write_run(arriving, document)
        arriving.rename(folder)
        return folder, document
    finally:
        shutil.rmtree(arriving, ignore_errors=True)


def _copy(document: RunDocument, rows: Store, there: Store) -> int:
    history = History(there.database)
    history.record(document)
    results = rows.results()
    count = 0
    while batch := list(islice(results, BATCH)):
        count += there.add(batch)
    history.record(document, counted=history.count_cells(document.run_id))
    return count


def _check_file(file: Path) -> None:
    try:
        with file.open("rb") as opened:
            start = opened.read(len(MAGIC))
    except OSError as error:
        raise RunError(f"{file}: expected an exported run: {error.strerror}") from None
    if start != MAGIC:
        raise RunError(f"{file}: expected an exported run (`robogauntlet export`), this is something else")


def _only_run(history: History) -> RunDocument:
    entries = history.runs(limit=2)
    if len(entries) != 1:
        found = "several" if entries else "none"
        raise RunError(f"{history.database.where}: expected one exported run, got {found}")
    return history.document(entries[0].run_id)


def _plain(text: str) -> str:
    """Replace all characters that are unsafe in a folder's name."""
    return "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in text)[:60] or "run"
