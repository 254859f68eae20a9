"""The folder and the store of a run while it plays. If somebody removes them, the run is saved beside its place."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Sequence
from pathlib import Path

from platformdirs import user_state_path

from robogauntlet.orchestrator.runs.plan import Plan
from robogauntlet.results.folder_lock import FolderError
from robogauntlet.results.record import EpisodeResult
from robogauntlet.results.run_document import (
    RUN_FILE,
    STORE_FILE,
    RunDocument,
    RunStatus,
    read_run,
    store_url,
    write_run,
)
from robogauntlet.results.run_owner import is_own, mark_as_own
from robogauntlet.results.store.database import StoreError, without_password
from robogauntlet.results.store.episode_store import Store
from robogauntlet.support.errors import describe_os_error
from robogauntlet.support.files import write_whole

UNMARKED = "replay will need --suite FILE, and a history that does not know the run records it as imported"


class RunPlace:
    """Where a run writes; it knows when that is not there any more."""

    def __init__(self, plan: Plan, folder: Path, document: RunDocument, url: str | None) -> None:
        """Open the store, and write the document into an existing folder; for `url` see `RunOptions.store`.

        Raises:
            FolderError: The folder has another suite, or cannot be written.
            RunError: The rows are in a database whose URL was not given.
            StoreError: The store cannot be opened.
        """
        continued = (folder / RUN_FILE).exists()
        if not continued and plan.path.exists() and plan.path.read_text(encoding="utf-8") != plan.text:
            raise FolderError(f"{plan.path}: expected no other suite in the folder of a new run; choose another folder")
        if continued and url is not None and without_password(url) != document.store_url:
            Store.open_begun(folder, document, url).close()  # another store, which must contain the run's rows
        self._plan, self.folder, self.url = plan, folder, url
        self.is_own = not continued or is_own(folder, read_run(folder))
        """Whether this user played all rows that are there."""
        self.warnings: list[str] = []
        self.store = Store.open(store_url(folder, document, url), document.run_id)
        try:
            self._write(document, plan.path)
        except OSError as error:
            self.store.close()
            raise FolderError(f"{folder}: {describe_os_error(error)}") from None

    def _write(self, document: RunDocument, suite: Path) -> None:
        if not suite.exists():  # composed of options
            write_whole(suite, self._plan.text)
        if not self.is_own:
            self.warnings = [f"{self.folder}: you did not begin this run in this folder; {UNMARKED}"]
        elif not mark_as_own(self.folder, document):
            self.warnings = [
                f"this run cannot be marked as yours, as {user_state_path()} cannot be written; {UNMARKED}"
            ]
        write_run(self.folder, document)
        self._found = self._look()

    def add(self, results: Sequence[EpisodeResult]) -> int:
        """Store rows as `Store.add`. Raises StoreError also if the folder or the store has gone."""
        added = self.store.add(results)
        if self.is_lost:
            raise StoreError(f"{self.folder}: removed, renamed or replaced while the run plays")
        return added

    @property
    def is_lost(self) -> bool:
        """Whether the folder or the file of the store was removed, renamed or replaced."""
        return self._look() != self._found

    def _look(self) -> list[tuple[int, int] | None]:
        """Which folder and which file of the store are there; None for what is not."""
        return [_identity(path) for path in (self.folder, self.store.file) if path is not None]

    def save_beside(self, document: RunDocument) -> RunDocument:
        """Continue in a new folder beside the lost one, with all rows; return the document of the stopped run.

        Raises:
            OSError: It cannot be written.
            StoreError: The rows cannot be read any more.
        """
        lost, names = self.folder, (f"{self.folder.name}-saved{number or ''}" for number in itertools.count())
        folder = next(path for name in names if not (path := lost.with_name(name)).exists())
        folder.mkdir(parents=True)
        url, file = self.url, self.store.file
        if file is not None and self._found[-1] != _identity(file):
            self.store.save_copy(folder / STORE_FILE)
            url = None
        store = Store.open(store_url(folder, document.model_copy(update={"store_url": None}), url), document.run_id)
        self.store.close()
        self.folder, self.store, self.url = folder, store, url

        def moved(text: str) -> str:
            path = Path(text)
            return str(folder / path.relative_to(lost)) if path.is_relative_to(lost) else text

        command = None if document.command is None else shlex.join(map(moved, shlex.split(document.command)))
        saved = document.model_copy(
            update={
                "status": RunStatus.STOPPED,
                "reason": f"{lost} was removed, renamed or replaced while the run played; all of it is in {folder}",
                "store_url": None if url is None else without_password(url),
                "suite_path": moved(document.suite_path),
                "command": command,
            }
        )
        self._write(saved, Path(saved.suite_path))
        return saved


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino
