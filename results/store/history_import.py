"""Records run folders in a history that lacks them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from robogauntlet.results.run_document import RUN_FILE, RunDocument, RunError, RunStatus, read_run
from robogauntlet.results.run_owner import is_own
from robogauntlet.results.store.database import StoreError, UnstorableValue
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.run_history import History

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
    places = {run_id: folder for folder, (run_id, _) in known.items()}
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
            if _is_copy(folder, document, places):
                passed_over(f"{folder.name} is passed over: a copy of {places[document.run_id]}")
                continue
            record_run_folder(history, folder, document)
            places[document.run_id] = str(folder)
            taken += 1
        except (RunError, UnstorableValue) as error:
            if str(folder) not in forgotten:
                passed_over(f"{folder.name} is passed over: {error}")
    return taken


def record_run_folder(history: History, folder: Path, document: RunDocument) -> None:
    """Record one run, with the counts of its cells if its rows can be read.

    A run that the history does not know, and that this user did not play in this folder, is the word of others.

    Raises:
        RunError: A run of others starts in the future.
        StoreError: The history cannot be written.
    """
    counted, imported = None, not (history.knows(document.run_id) or is_own(folder, document))
    if imported:
        refuse_future(document)
    with contextlib.suppress(RunError, StoreError), closing(Store.open_begun(folder, document)) as rows:
        counted = History(rows.database).count_cells(document.run_id)
    history.record(document, folder, counted, imported=imported)


def refuse_future(document: RunDocument) -> None:
    """Refuse a run of others that would stay the newest. Raises RunError."""
    if document.started_at > time.time() + CLOCKS_S:
        started = datetime.fromtimestamp(document.started_at, UTC)
        raise RunError(f"run {document.run_id}: expected a start in the past, got {started:%Y-%m-%d %H:%M} UTC")


def _is_copy(folder: Path, document: RunDocument, places: Mapping[str, str]) -> bool:
    """Whether the history has this run in another folder, which still holds it."""
    other = places.get(document.run_id)
    if other is None or Path(other) == folder:
        return False
    with contextlib.suppress(RunError):
        return read_run(Path(other)).run_id == document.run_id
    return False
