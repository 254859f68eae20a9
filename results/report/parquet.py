"""`episodes.parquet`: all rows with all fields, and a description of each column."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.tables import CATEGORIES, COLUMNS
from robogauntlet.results.record import describe_fields
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store.episode_store import Store

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

BATCH = 10_000
"""Rows in memory at a time, and per row group."""


def schema(document: RunDocument) -> pa.Schema:
    """Return the columns of the file: the fields of `EpisodeResult`, each with its `description`."""
    import pyarrow as pa

    types = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}
    fields = [
        pa.field(name, types[kind], nullable=nullable, metadata={"description": sentence})
        for name, (kind, nullable, sentence) in describe_fields().items()
    ]
    about = {"run_id": document.run_id, "suite_name": document.suite.name, "suite_hash": document.suite_hash}
    return pa.schema(fields, metadata=about)


def write_parquet(path: Path, document: RunDocument, store: Store) -> None:
    """Write all rows of a store. Raises StoreError or OSError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = schema(document)
    with pq.ParquetWriter(path, columns, compression="zstd") as writer:
        for rows in store.batches(BATCH):
            values = zip(*rows, strict=True)
            arrays = [pa.array(column, type=field.type) for column, field in zip(values, columns, strict=True)]
            writer.write_table(pa.Table.from_arrays(arrays, schema=columns))


def read_frame(
    path: Path, columns: Sequence[str] = COLUMNS, where: tuple[str, Collection[str]] | None = None
) -> pd.DataFrame:
    """Read columns of an `episodes.parquet`, texts with few values as categories.

    `where` is a column and its wanted values; by default all rows are read.
    """
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    categories = [name for name in CATEGORIES if name in columns]
    wanted = None if where is None else pc.field(where[0]).isin(pa.array(list(where[1]), type=pa.string()))
    table = pq.read_table(path, columns=list(columns), read_dictionary=categories, filters=wanted)
    return table.to_pandas(split_blocks=True, self_destruct=True)
