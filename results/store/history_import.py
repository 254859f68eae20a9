"""Records run folders in a history that lacks them."""

from __future__ import annotations

import contextlib
from contextlib import closing
from pathlib import Path

from robogauntlet.results.run_document import RUN_FILE, RunDocument, RunError, RunStatus, read_run
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.run_history import History


def record_run_folders(history: History, root: Path) -> int:
    """Record the runs in folders directly under `root` that are missing in the history or have another status there.

    Other folders, and documents of another format, are skipped. Returns the number of recorded runs.

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
        record_run_folder(history, file.parent, document)
        taken += 1
    return taken


def record_run_folder(history: History, folder: Path, document: RunDocument) -> None:
    """Record one run, with the counts of its cells if its rows can be read. Raises StoreError."""
    counted = None
    with contextlib.suppress(RunError, StoreError), closing(Store.open_begun(folder, document)) as rows:
        counted = History(rows.database).count_cells(document.run_id)
    history.record(document, folder, counted)
