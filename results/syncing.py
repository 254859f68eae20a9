"""Tells a history of runs that it does not know: those in a folder, made before it or while it could not be written."""

from __future__ import annotations

from pathlib import Path

from results.database import StoreError
from results.history import History
from results.run import RUN_FILE, RunDocument, RunError, RunStatus, read_run
from results.store import Store


def take_in(history: History, root: Path) -> int:
    """Record runs in folders directly under `root` that the history lacks or knows another status of.

    Folders that are no runs, or of another version, are passed over.

    Returns:
        How many were recorded.

    Raises:
        StoreError: The history cannot be read or written.
    """
    known = history.folders()
    taken = 0
    for file in sorted(root.absolute().glob(f"*/{RUN_FILE}")):
        _, status = known.get(str(file.parent), ("", None))
        if status not in (None, str(RunStatus.RUNNING)):
            continue
        try:
            document = read_run(file.parent)
        except RunError:
            continue
        if status == str(document.status):
            continue
        take_in_run(history, file.parent, document)
        taken += 1
    return taken


def take_in_run(history: History, folder: Path, document: RunDocument) -> None:
    """Record one run, with what came of it if its rows can be reached. Raises StoreError."""
    try:
        rows = Store.open_begun(folder, document)
    except (RunError, StoreError):
        history.record(document, folder)
        return
    try:
        history.record(document, folder, History(rows.database).counted(document.run_id))
    finally:
        rows.close()
