"""Records run folders in a history that lacks them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from robogauntlet.results.run_document import RUN_FILE, RunDocument, RunError, RunStatus, read_run
from robogauntlet.results.store.database import StoreError, UnstorableValue
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.run_history import History


def record_run_folders(history: History, root: Path, passed_over: Callable[[str], None] = lambda line: None) -> int:
    """Record the runs in folders directly under `root` that are missing in the history or have another status there.

    Forgotten runs and hidden folders are skipped. `passed_over` is called with a line for each run that cannot be read
    or recorded. Returns the number of recorded runs.

    Raises:
        StoreError: The history cannot be read or written.
    """
    known, forgotten = history.folders(), history.forgotten_folders()
    taken = 0
    for file in sorted(root.absolute().glob(f"*/{RUN_FILE}")):
        folder = file.parent
        _, status = known.get(str(folder), ("", None))
        if folder.name.startswith(".") or status not in (None, str(RunStatus.RUNNING)):
            continue
        try:
            document = read_run(folder)
            if status != str(document.status) and forgotten.get(str(folder)) != document.run_id:
                record_run_folder(history, folder, document)
                taken += 1
        except (RunError, UnstorableValue) as error:
            if str(folder) not in forgotten:
                passed_over(f"{folder.name} is passed over: {error}")
    return taken


def record_run_folder(history: History, folder: Path, document: RunDocument) -> None:
    """Record one run, with the counts of its cells if its rows can be read. Raises StoreError."""
    counted = None
    with contextlib.suppress(RunError, StoreError), closing(Store.open_begun(folder, document)) as rows:
        counted = History(rows.database).count_cells(document.run_id)
    history.record(document, folder, counted)
