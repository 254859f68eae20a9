"""Records a run and its live status in the history of all runs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robogauntlet.orchestrator.runs.observer import Observer, RunState
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store.database import StoreError, without_password
from robogauntlet.results.store.episode_store import check_place
from robogauntlet.results.store.run_history import History

LIVE_STATUS_S = 1.0
"""Time between two live statuses (s)."""


class HistoryObserver(Observer):
    """Writes one run into a history, which may be in the store that has its rows."""

    def __init__(self, url: str, folder: Path, schedule: str | None = None) -> None:
        """Record a run in `folder` at the URL of a history, with the schedule that starts it, if any.

        Raises:
            StoreError: The history would take the place of another file of the run folder.
        """
        check_place(folder, url)
        self._url, self._schedule = url, schedule
        self._history: History | None = None
        self._is_store = False
        """Whether the history is in the store that has the rows, in which the run records itself."""
        self._folder: Path | None = None
        self._recorded: RunDocument | None = None
        self._live_status_at = 0.0

    def on_start(self, run: RunState) -> None:
        """Open the history and record the run in it."""
        with _as_warning("this run is not recorded in the history"):
            self._open(run)
        self._record(run)

    def on_tick(self, run: RunState) -> None:
        """Write the live status, at most once a second."""
        if self._history is None or time.monotonic() - self._live_status_at < LIVE_STATUS_S:
            return
        self._live_status_at = time.monotonic()
        with _as_warning("the history could not be written"):
            self._history.write_live_status(run.document.run_id, run.live())

    def on_numbers(self, run: RunState) -> None:
        """Record the run's result."""
        self._record(run)

    def on_end(self, run: RunState) -> None:
        """Record what has changed since, such as the time that videos took."""
        if run.document is not self._recorded:
            self._record(run)

    def close(self) -> None:
        """Close the connections that are its own."""
        if self._history is not None and not self._is_store:
            self._history.close()
        self._history = None

    def _open(self, run: RunState) -> None:
        self.close()
        self._folder = run.folder
        self._is_store = without_password(self._url) == run.store.database.where
        self._history = History(run.store.database) if self._is_store else History.open(self._url)

    def _record(self, run: RunState) -> None:
        with _as_warning("the history could not be written"):
            if run.folder != self._folder:  # it goes on beside its place, which was removed
                self._open(run)
            self._recorded = run.document
            if self._history is None or self._is_store:
                return
            imported = not run.is_own and not self._history.knows(run.document.run_id)
            self._history.record(run.document, run.folder, run.cells, self._schedule, imported=imported)


@contextmanager
def _as_warning(what: str) -> Iterator[None]:
    try:
        yield
    except StoreError as error:
        raise StoreError(f"{what}: {error}") from None
