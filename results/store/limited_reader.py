"""Reads an exported run in a process of its own, whose memory, time and files are limited.

Whatever a sender's file does to SQLite or to the parser of documents, it does to that process, which copies the run
into a folder. What the other process reads of it was written by our code.
"""

from __future__ import annotations

import contextlib
import math
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from robogauntlet.results.record import outcome_row, rows_hash
from robogauntlet.results.run_document import STORE_FILE, RunDocument, RunError, read_run, write_run
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.exported_file import exported_size, open_exported, reading_time_s
from robogauntlet.results.store.run_history import History
from robogauntlet.support.child_process import ChildEnded, ChildTimeout, JsonChild, serve
from robogauntlet.support.text import shortened

COMMAND = (sys.executable, "-P", "-m", "robogauntlet.results.store.limited_reader")
"""Starts the process; -P, since the current folder may hold modules of others."""
START_S = 30.0
"""Time in which the process starts, beside that for reading (s)."""
MEMORY, MEMORY_PER_BYTE = 2**30, 1
"""Address space: the former, and so much for each byte of the file, whose rows are hashed (bytes)."""
WRITTEN, WRITTEN_PER_BYTE = 2**26, 6
"""Size of a file that it writes, in the same way: a character may take 4 bytes, and keys are in indexes too."""
OPEN_FILES = 64
BATCH = 500
"""Rows that are held in memory at once: with the longest texts, some hundred MB."""
LONGEST_MESSAGE = 10_000


class LimitedReader:
    """An exported run that another process reads; see `limited_reader`."""

    def __init__(self, child: JsonChild, file: Path, folder: Path) -> None:
        """Let the process check the file and write its document into the folder."""
        size = exported_size(file)
        self._child, self._file = child, file
        self._deadline = time.monotonic() + reading_time_s(size) + START_S
        self._ask({"file": str(file), "folder": str(folder), "limits": _limits(size)})
        self.document: RunDocument = read_run(folder)

    def copy_rows(self) -> None:
        """Let it copy all rows into a new store in the folder.

        Raises:
            RunError: A row is wrong or there twice, or the rows hash to something else than the document says; or
                the process was ended by a limit or an error.
            StoreError: The store cannot be written.
        """
        self._ask("rows")

    def _ask(self, request: object) -> None:
        try:
            answer = self._child.ask(request, max(0.0, self._deadline - time.monotonic()))
        except (ChildEnded, ChildTimeout) as error:
            reason = _why_it_ended(error, self._child.stderr)
            raise RunError(f"{self._file}: expected an exported run (`robogauntlet export`), {reason}") from error
        match answer:
            case {"RunError": message}:
                raise RunError(message)
            case {"StoreError": message}:
                raise StoreError(message)
            case {"OSError": [number, reason, name]}:
                raise OSError(number, reason, name)


@contextmanager
def limited_reader(file: Path, folder: Path) -> Iterator[LimitedReader]:
    """Open an exported run in another process, which ends with the block.

    Args:
        file: The exported run, from an untrusted source.
        folder: An empty folder, which becomes a run folder: it gets the document, whose origin is `imported`, and by
            `copy_rows` the rows.

    Raises:
        RunError: It is no exported run, or has another version; or the process was ended by a limit or an error.
        OSError: The folder cannot be written.
    """
    with JsonChild(COMMAND, own_group=True) as child:
        yield LimitedReader(child, file, folder)


def _why_it_ended(error: ChildEnded | ChildTimeout, last_words: str) -> str:
    how = str(error).partition(": ")[0]
    if isinstance(error, ChildTimeout) or "SIGXCPU" in how:
        return "reading it takes too long"
    if "MemoryError" in last_words or "memory allocation" in last_words:  # of Python, of pydantic's parser
        return "reading it takes too much memory"
    if "SIGXFSZ" in how:
        return "reading it writes too much"
    return f"it cannot be read: {how}"


def _limits(size: int) -> dict[str, int]:
    """Limits of the process that reads a file of this many bytes, by the name that `resource` has for them."""
    return {
        "RLIMIT_AS": MEMORY + MEMORY_PER_BYTE * size,
        "RLIMIT_CPU": math.ceil(reading_time_s(size) + START_S),
        "RLIMIT_FSIZE": WRITTEN + WRITTEN_PER_BYTE * size,
        "RLIMIT_NOFILE": OPEN_FILES,
        "RLIMIT_CORE": 0,
    }


# What follows runs in the other process.


class Copier:
    """Copies an exported run into a folder. Not limited: errors of SQLite's own code end the process."""

    def __init__(self, file: Path, folder: Path) -> None:
        """Open the file and write its document. Raises RunError, OSError."""
        with ExitStack() as stack:
            self._exported = stack.enter_context(open_exported(file))
            self._file, self._store = file, folder / STORE_FILE
            self._document = self._exported.document.model_copy(update={"origin": "imported", "command": None})
            write_run(folder, self._document)
            self._opened = stack.pop_all()

    def copy_rows(self) -> None:
        """See `LimitedReader.copy_rows`."""
        document = self._document.model_copy(update={"store_url": None})
        with closing(Store.open_file(self._store, document.run_id)) as store:
            history = History(store.database)
            history.record(document)
            found = rows_hash(self._copied(store))
            if document.rows_hash is not None and found != document.rows_hash:
                raise RunError(f"{self._file}: its rows hash to {found}, not {document.rows_hash}: it was changed")
            history.record(document, counted=history.count_cells(document.run_id))

    def _copied(self, store: Store) -> Iterator[tuple[Any, ...]]:
        results = self._exported.rows()
        while batch := list(islice(results, BATCH)):
            if store.add(batch) != len(batch):
                raise RunError(f"{self._file}: expected each episode once, one is there twice")
            yield from map(outcome_row, batch)

    def close(self) -> None:
        """Close the file."""
        self._opened.close()


def limit_this_process(limits: dict[str, int]) -> None:
    """Set limits by the name that `resource` has for them; none is raised, and a system may lack some."""
    import resource  # not on Windows

    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)  # ends this process, where Python would go on with an error
    for name, most in limits.items():
        kind = getattr(resource, name)
        soft, hard = (math.inf if limit == resource.RLIM_INFINITY else limit for limit in resource.getrlimit(kind))
        value = min(most, soft, hard)
        last = value + 1 if name == "RLIMIT_CPU" else value  # the hard limit of time kills without saying why
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (int(value), int(min(last, hard))))


def answer_requests() -> None:
    """Open the file that the first request names, and copy its rows at the second."""
    copiers: list[Copier] = []

    def answer(request: Any) -> dict[str, Any]:
        try:
            if copiers:
                copiers[0].copy_rows()
            else:
                limit_this_process(request["limits"])
                copiers.append(Copier(Path(request["file"]), Path(request["folder"])))
        except (RunError, StoreError) as error:
            kind = "RunError" if isinstance(error, RunError) else "StoreError"
            return {kind: shortened(str(error), LONGEST_MESSAGE)}
        except OSError as error:
            return {"OSError": [error.errno, error.strerror, error.filename and str(error.filename)]}
        return {}

    serve(answer)


if __name__ == "__main__":
    answer_requests()
