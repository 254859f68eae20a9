"""Run documents and exported runs with a wrong value."""

import io
import json
import zipfile
from collections.abc import Callable
from functools import partial
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq


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
    return rewritten(good, {"run.json": partial(document_with, place, value)})


def exported_rows(change: Callable[[list[dict[str, Any]]], object], good: bytes) -> bytes:
    """An exported run whose rows, a list of dictionaries, are changed."""

    def changed(content: bytes) -> bytes:
        table = pq.read_table(io.BytesIO(content))
        rows = table.to_pylist()
        change(rows)
        return parquet(pa.Table.from_pylist(rows, schema=table.schema))

    return rewritten(good, {"episodes.parquet": changed})


def exported_row(good: bytes, **values: Any) -> bytes:
    """An exported run whose fifth row has other values."""
    return exported_rows(lambda rows: rows[4].update(values), good)


def exported_table(change: Callable[[pa.Table], pa.Table], good: bytes) -> bytes:
    """An exported run whose table of rows is another one."""
    return rewritten(good, {"episodes.parquet": lambda old: parquet(change(pq.read_table(io.BytesIO(old))))})


def rewritten(good: bytes, changes: dict[str, Callable[[bytes], bytes] | bytes | None]) -> bytes:
    """An exported run with other files: what becomes of their bytes, other bytes, or None for none."""
    with zipfile.ZipFile(io.BytesIO(good)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    for name, change in changes.items():
        old = files.pop(name, b"")
        if change is not None:
            files[name] = change(old) if callable(change) else change
    return packed(list(files.items()))


def packed(files: list[tuple[str | zipfile.ZipInfo, bytes]]) -> bytes:
    """A ZIP archive of these files."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in files:
            archive.writestr(name, content)
    return buffer.getvalue()


def parquet(table: pa.Table) -> bytes:
    """A Parquet file."""
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    return buffer.getvalue()
