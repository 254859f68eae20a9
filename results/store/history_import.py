"""Records run folders in a history that lacks them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import RUN_FILE, RunDocument, RunError, RunStatus, read_run
from robogauntlet.results.run_owner import is_own
from robogauntlet.results.store.database import StoreError, UnstorableValue
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.history_records import RunEntry
from robogauntlet.results.store.run_history import SHORTEST_ID, History

IDENTITY = ("suite", "suite_hash", "plan", "started_at", "rows_hash")
"""Fields of a document that a run has wherever its folder is moved."""
CLOCKS_S = 86_400.0
"""By how much the clock of another machine may be ahead (s)."""


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
            if status == str(document.status) or forgotten.get(str(folder)) == document.run_id:
                continue
            record_run_folder(history, folder, document)
            taken += 1
        except (RunError, UnstorableValue) as error:
            if str(folder) not in forgotten:
                passed_over(f"{folder.name} is passed over: {error}")
    return taken


def record_run_folder(history: History, folder: Path, document: RunDocument) -> None:
    """Record one run, with the counts of its cells if its rows can be read.

    A run that the history does not know, and that this user did not play in this folder, is recorded as imported.

    Raises:
        RunError: The history has another run of this id, or the same in a folder that is still there; or a run of
            others starts in the future.
        StoreError: The history cannot be written.
    """
    counted, imported = None, False
    if (entry := next(iter(history.entries([document.run_id])), None)) is None:
        if imported := not is_own(folder, document):
            refuse_future(document)
    elif entry.folder != str(folder.absolute()):
        _refuse_another_run(history, entry, folder, document)
    with contextlib.suppress(RunError, StoreError), closing(Store.open_begun(folder, document)) as rows:
        counted = History(rows.database).count_cells(document.run_id)
    history.record(document, folder, counted, imported=imported)


def refuse_future(document: RunDocument) -> None:
    """Refuse a run of others that would stay the newest. Raises RunError."""
    if document.started_at > time.time() + CLOCKS_S:
        started = datetime.fromtimestamp(document.started_at, UTC)
        raise RunError(f"run {document.run_id}: expected a start in the past, got {started:%Y-%m-%d %H:%M} UTC")


def _refuse_another_run(history: History, entry: RunEntry, folder: Path, document: RunDocument) -> None:
    """Refuse a folder that is a copy of a run's folder, or that only says that it is the run. Raises RunError."""
    held = None
    with contextlib.suppress(RunError):
        held = None if entry.folder is None else read_run(Path(entry.folder)).run_id
    if held == document.run_id:
        raise RunError(f"a copy of {entry.folder}")
    stored = history.document(document.run_id)
    same = all(getattr(stored, name) == getattr(document, name) for name in IDENTITY)
    if same and document.rows_hash is not None:
        in_history = document.store_url == history.database.where
        of_history = contextlib.nullcontext(Store(history.database, document.run_id))
        with of_history if in_history else closing(Store.open_begun(folder, document)) as rows:
            same = rows_hash(map(outcome_row, rows.results())) == document.rows_hash
    if not same:
        raise RunError(
            f"it says that it is run {document.run_id}, which the history has with other policies or rows; "
            f"if this one counts: robogauntlet list runs --forget {document.run_id[:SHORTEST_ID]}"
        )
