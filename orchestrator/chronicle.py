"""Tells the stores what a run is and does: the one with its rows, and the history of all runs if there is one."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from results.database import StoreError, without_password
from results.history import History
from results.live import Live
from results.run import RunDocument
from results.store import Store

TELL_S = 1.0
"""Between two words of a running suite (s)."""


class Chronicle:
    """What the stores know of one run. What the history cannot take never ends the run."""

    def __init__(self, folder: Path, store: Store, history: History | None, schedule: str | None = None) -> None:
        """See `open`."""
        self._folder, self._schedule = folder, schedule
        self._own = History(store.database)
        self._history = history
        self._told = 0.0
        self.troubles: list[str] = []

    @classmethod
    def open(cls, folder: Path, store: Store, url: str | None, schedule: str | None = None) -> Chronicle:
        """Begin to tell.

        Args:
            folder: Of the run.
            store: With its rows.
            url: Of the history, or None for none.
            schedule: The schedule that began the run, if one did.
        """
        history, trouble = None, None
        if url is not None:
            try:
                same = without_password(url) == store.database.where
                history = History(store.database) if same else History.open(url)
            except StoreError as error:
                trouble = f"the history does not learn of this run: {error}"
        chronicle = cls(folder, store, history, schedule)
        if trouble:
            chronicle.troubles.append(trouble)
        return chronicle

    def record(self, document: RunDocument, *, counted: bool = True) -> None:
        """Write what the run is, and what it came to.

        Args:
            document: The run.
            counted: Whether to count its rows anew, which takes a second or two for a million.

        Raises:
            StoreError: The store with the rows cannot be written.
        """
        counts = self._own.counted(document.run_id) if counted else None
        self._own.record(document, self._folder, counts, self._schedule)
        if self._history is not None and self._history.database is not self._own.database:
            try:
                self._history.record(document, self._folder, counts, self._schedule)
            except StoreError as error:
                self._lose(error)

    def tell(self, run_id: str, live: Callable[[], Live]) -> None:
        """Say what the run does, at most once a second."""
        if self._history is None or time.monotonic() - self._told < TELL_S:
            return
        self._told = time.monotonic()
        try:
            self._history.tell(run_id, live())
        except StoreError as error:
            self._lose(error)

    def close(self) -> None:
        """Free the connections."""
        if self._history is not None and self._history.database is not self._own.database:
            self._history.close()

    def _lose(self, error: StoreError) -> None:
        self.troubles.append(f"the history could not be written: {error}")
        self.close()
        self._history = None
