"""Records a run and its live status in its own store and, if configured, in the history of all runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from robogauntlet.results.live_status import LiveStatus
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store.database import StoreError, without_password
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.run_history import History

LIVE_STATUS_S = 1.0
"""Time between two live statuses (s)."""


class HistoryWriter:
    """Writes one run into the stores. The run goes on if the history cannot be written."""

    def __init__(self, folder: Path, store: Store, url: str | None, schedule: str | None, *, imported: bool) -> None:
        """Open the history at `url`, if any, besides the store with the run's rows.

        A history that does not know the run records it as imported if `imported`.
        """
        self._folder, self._schedule, self._imported = folder, schedule, imported
        self._run_history = History(store.database)
        self._history: History | None = None
        self._live_status_at = 0.0
        self.warnings: list[str] = []
        if url is not None:
            try:
                same = without_password(url) == store.database.where
                self._history = self._run_history if same else History.open(url)
            except StoreError as error:
                self.warnings.append(f"this run is not recorded in the history: {error}")

    def record(self, document: RunDocument, *, counted: bool = True) -> None:
        """Write the run's document and, if `counted`, the counts of its cells: a second or two per million rows.

        Raises:
            StoreError: The store with the rows cannot be written.
        """
        counts = self._run_history.count_cells(document.run_id) if counted else None
        self._run_history.record(document, self._folder, counts, self._schedule)
        if self._history not in (None, self._run_history):
            try:
                imported = self._imported and not self._history.knows(document.run_id)
                self._history.record(document, self._folder, counts, self._schedule, imported=imported)
            except StoreError as error:
                self._drop_history(error)

    def update_live_status(self, run_id: str, live: Callable[[], LiveStatus]) -> None:
        """Write the live status, at most once a second."""
        if self._history is None or time.monotonic() - self._live_status_at < LIVE_STATUS_S:
            return
        self._live_status_at = time.monotonic()
        try:
            self._history.write_live_status(run_id, live())
        except StoreError as error:
            self._drop_history(error)

    def close(self) -> None:
        """Close the connections."""
        if self._history not in (None, self._run_history):
            self._history.close()

    def _drop_history(self, error: StoreError) -> None:
        self.warnings.append(f"the history could not be written: {error}")
        self.close()
        self._history = None
