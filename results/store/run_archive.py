"""Export and import of a run as one file: a store with only this run and its document."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from itertools import islice
from pathlib import Path

from robogauntlet.results.run_document import STORE_FILE, RunDocument, RunError, write_run
from robogauntlet.results.store.arriving import arriving_file, arriving_folder
from robogauntlet.results.store.database import StoreError, without_password
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.exported_file import exported_size
from robogauntlet.results.store.history_import import refuse_future
from robogauntlet.results.store.limited_reader import limited_reader
from robogauntlet.results.store.run_history import History

BATCH = 10_000


def export_run(document: RunDocument, rows: Store, file: Path) -> int:
    """Write a run into a new file and return the number of rows. A crash leaves no file.

    Raises:
        RunError: The file exists.
        StoreError: Rows cannot be read or written.
        OSError: The file cannot be written.
    """
    if file.exists():
        raise RunError(f"{file}: expected a new file, there is one already")
    with arriving_file(file) as partial:
        with closing(Store.open_file(partial, document.run_id)) as copy:
            count = _copy(document.model_copy(update={"store_url": None}), rows, copy)
        with sqlite3.connect(partial) as connection:
            connection.execute("PRAGMA journal_mode=DELETE")  # One file without a log beside it.
        connection.close()
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
        RunError: It is no exported run, has another version, a start in the future, changed rows, or the folder exists.
        StoreError: The store cannot be written.
        OSError: The folder cannot be written.
    """
    url = None if store is None else without_password(store)
    exported_size(file)  # what is no file is refused before anything is written
    with arriving_folder(root) as arriving:
        run = arriving / "run"
        run.mkdir()
        with limited_reader(file, run) as reader:
            document = reader.document
            refuse_future(document)
            if check is not None:
                check(document)
            folder = root / (name or f"{document.suite.name}-{document.run_id[:8]}")
            if folder.exists():
                raise RunError(f"{folder}: expected a new folder, there is one already; name another with --out")
            reader.copy_rows()
        document = document.model_copy(update={"store_url": url})
        write_run(run, document)
        if store is not None:
            _move_rows(run / STORE_FILE, document, store)
        run.rename(folder)
    return folder, document


def discard(folder: Path, document: RunDocument, store: str | None) -> None:
    """Remove a run that was just imported, with its rows in `store`, if they are there. Raises nothing."""
    shutil.rmtree(folder, ignore_errors=True)
    if store is not None:
        with contextlib.suppress(StoreError), closing(History.open(store)) as history:
            history.remove(document.run_id)


def _move_rows(file: Path, document: RunDocument, url: str) -> None:
    """Move the rows of a run from a store of ours in a file into another. If that fails, nothing is left there.

    Raises:
        RunError: The other store knows the run already.
        StoreError: It cannot be written.
    """
    with closing(Store.open(url, document.run_id)) as there:
        if there.knows_run():
            raise RunError(f"{there.database.where}: run {document.run_id} is there already")
        try:
            with closing(Store.open_file(file, document.run_id)) as rows:
                _copy(document, rows, there)
        except BaseException:
            with contextlib.suppress(StoreError):
                History(there.database).remove(document.run_id)
            raise
    for path in file.parent.glob(f"{file.name}*"):
        path.unlink()


def _copy(document: RunDocument, rows: Store, there: Store) -> int:
    history = History(there.database)
    history.record(document)
    results = rows.results()
    count = 0
    while batch := list(islice(results, BATCH)):
        count += there.add(batch)
    history.record(document, counted=history.count_cells(document.run_id))
    return count
