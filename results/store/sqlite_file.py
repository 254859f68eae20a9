"""What is particular to a store in an SQLite file: what may be one, settings of its connections, write-ahead logging.

SQLite's locks belong to the process: closing any other descriptor of the file ends them. So nothing here opens it.
"""

from __future__ import annotations

import os
import sqlite3
import stat
import time
from pathlib import Path
from typing import Any

import sqlalchemy as sa

BUSY_S = 30.0
"""Time to wait for another process that writes (s)."""
SHORTEST = 512
"""Smallest size of a database (bytes). SQLite takes a shorter file for an empty database, and would overwrite it."""


def why_no_database(file: Path, *, create: bool) -> str | None:
    """Return why the file cannot be a database or, with `create`, become one; None if it may be, or cannot be seen."""
    try:
        found = file.stat()
    except FileNotFoundError:
        return None if create else "there is no such file"
    except (OSError, ValueError):
        return None  # SQLite says why
    if not stat.S_ISREG(found.st_mode):
        return "this is a directory" if stat.S_ISDIR(found.st_mode) else "this is no file"
    if found.st_size == 0 and not create:
        return "this file is empty; restore it from a copy, or remove it"
    if 0 < found.st_size < SHORTEST:
        return "this file is something else"
    return None


def why_not_opened(file: Path) -> str | None:
    """Return what to do about a file that SQLite was unable to open, or None if it is not known."""
    folder = file.absolute().parent
    if folder.is_dir() and not os.access(folder, os.W_OK):
        return "expected a store in a place that can be written, which reading takes too; copy it to one"
    return None


def tune(connection: sqlite3.Connection, _record: Any) -> None:
    """Set up a connection."""
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout={int(1000 * BUSY_S)}")
    cursor.execute("PRAGMA trusted_schema=OFF")  # The file may be from an untrusted source.
    cursor.execute("PRAGMA synchronous=NORMAL")
    cursor.close()


def use_write_ahead_log(connection: sa.Connection) -> None:
    """Let readers read while another process writes. The file keeps this setting. Raises OperationalError."""
    deadline = time.monotonic() + BUSY_S
    while True:
        try:
            connection.exec_driver_sql("PRAGMA journal_mode=WAL").close()
            return
        except sa.exc.OperationalError as error:
            # SQLite ignores the time-out here while another process opens the store.
            code = getattr(error.orig, "sqlite_errorcode", None)
            if code != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(0.01)
