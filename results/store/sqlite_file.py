"""What is particular to a store in an SQLite file: what may be one, settings of its connections, write-ahead logging.

SQLite's locks belong to the process: closing any other descriptor of the file ends them. So nothing here opens it.
"""

from __future__ import annotations

import contextlib
import math
import os
import sqlite3
import stat
import time
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.util import asbool

BUSY_S = 30.0
"""Time to wait for another process that writes (s)."""
SHORTEST = 512
"""Smallest size of a database (bytes). SQLite takes a shorter file for an empty database, and would overwrite it."""

COMPANIONS = ("-journal", "-wal", "-shm")
"""Ends of the names of the files that SQLite keeps beside a database."""
BOOLEANS = ("uri", "check_same_thread", "immutable", "nolock", "psow")
WORDS = {"mode": ("ro", "rw", "rwc"), "cache": ("shared", "private"), "vfs": None}
"""Parameters of SQLite's own URLs, which `uri=true` turns on, with their values; None for any."""


def why_no_url(url: sa.URL) -> str | None:
    """Return what is wrong with the URL of an SQLite store: it names no file, or a parameter is none of SQLite's."""
    if file_of(url) is None:
        return "expected the file of a store, as in sqlite:///FILE; a store in memory loses its rows"
    for name, value in url.query.items():
        if not isinstance(value, str):
            return f"expected the parameter {name} once"
        if name == "timeout":
            if not _is_time(value):
                return f"timeout={value}: expected a number of seconds"
        elif name in BOOLEANS:
            if value.lower() not in ("true", "false", "1", "0", "yes", "no", "on", "off"):
                return f"{name}={value}: expected true or false"
        elif name not in WORDS:
            return f"unknown parameter '{name}'; known: {', '.join(('timeout', *BOOLEANS, *WORDS))}"
        elif (known := WORDS[name]) and value not in known:
            return f"{name}={value}: expected one of {', '.join(known)}"
        if name not in ("timeout", "uri", "check_same_thread") and not asbool(url.query.get("uri", "false")):
            return f"expected uri=true beside {name}={value}, and file:FILE in place of FILE"
    return None


def _is_time(text: str) -> bool:
    try:
        return 0 <= float(text) < math.inf
    except ValueError:
        return False


def file_of(url: sa.URL) -> Path | None:
    """The file that a URL names; None for a server and for a store in memory."""
    if url.get_backend_name() != "sqlite":
        return None
    name = url.database or ""
    if "uri" in url.query:
        name = name.removeprefix("file:")
    return None if name in ("", ":memory:") else Path(name)


def why_no_database(file: Path, *, create: bool) -> str | None:
    """Return why the file cannot be a database or, with `create`, become one; None if it may be, or cannot be seen."""
    try:
        for path in (Path(f"{file}{end}") for end in COMPANIONS):
            with contextlib.suppress(FileNotFoundError):  # another process may have removed it meanwhile
                if not stat.S_ISREG(path.stat().st_mode):  # SQLite waits for what comes from a named pipe
                    return f"{path.name} beside it is no file"
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
