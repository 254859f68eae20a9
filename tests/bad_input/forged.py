"""Run documents and exported runs with a wrong value."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any


def document_with(place: str, value: Any, good: bytes) -> bytes:
    """A run document with another value at a place such as `plan:0:task`."""
    content = json.loads(good)
    *path, last = place.split(":")
    inner = content
    for key in path:
        inner = inner[int(key) if isinstance(inner, list) else key]
    inner[last] = value
    return json.dumps(content).encode()


def exported_with(place: str, value: Any, good: bytes) -> bytes:
    """An exported run whose document has another value at a place such as `plan:0:task`."""

    def change(connection: sqlite3.Connection) -> None:
        ((text,),) = connection.execute("SELECT document FROM runs")
        connection.execute("UPDATE runs SET document = ?", [document_with(place, value, text.encode()).decode()])

    return _changed(good, change)


def exported_after(statements: str, good: bytes) -> bytes:
    """An exported run after statements of SQL."""
    return _changed(good, lambda connection: connection.executescript(statements))


def _changed(good: bytes, change) -> bytes:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "run.robogauntlet"
        file.write_bytes(good)
        with closing(sqlite3.connect(file)) as connection, connection:
            change(connection)
        return file.read_bytes()
