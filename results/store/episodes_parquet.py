"""`episodes.parquet`: the rows of a run with all fields, and a description of each column."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robogauntlet.results.record import LATER, describe_fields
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store.episode_store import Store

if TYPE_CHECKING:
    import pyarrow as pa

EPISODES_FILE = "episodes.parquet"
BATCH = 10_000
"""Rows in memory at a time, and per row group."""
LARGEST_GROUP = 2**30
"""Largest size of a row group of others (bytes, not compressed)."""


class NoEpisodes(ValueError):
    """A file that holds no rows of this program; the message says why and does not name it."""


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


def write_parquet(path: Path, document: RunDocument, store: Store) -> int:
    """Write all rows of a store and return their number. Raises StoreError or OSError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns, count = schema(document), 0
    with pq.ParquetWriter(path, columns, compression="zstd") as writer:
        for rows in store.batches(BATCH):
            values = zip(*rows, strict=True)
            arrays = [pa.array(column, type=field.type) for column, field in zip(values, columns, strict=True)]
            writer.write_table(pa.Table.from_arrays(arrays, schema=columns))
            count += len(rows)
    return count


def read_rows(path: Path, document: RunDocument, batch: int) -> Iterator[Sequence[tuple[Any, ...]]]:
    """Yield the rows of a file of others as plain values in the order of `FIELDS`, at most `batch` at a time.

    A file of an earlier version lacks `LATER` fields, which are None.

    Raises:
        NoEpisodes: It is damaged, has other columns or more rows than the run has episodes, or is too large.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            wanted, there = schema(document), file.schema_arrow
            missing = {name for name in LATER if name not in there.names}
            if not there.equals(pa.schema([field for field in wanted if field.name not in missing])):
                raise NoEpisodes("its columns are not those of this program")
            about = file.metadata
            if about.num_rows > document.planned:
                raise NoEpisodes(f"it has {about.num_rows:,} rows, the run {document.planned:,} episodes")
            if any(about.row_group(i).total_byte_size > LARGEST_GROUP for i in range(about.num_row_groups)):
                raise NoEpisodes(f"it has a row group of more than {LARGEST_GROUP:,} bytes")
            for part in file.iter_batches(batch):
                empty = [None] * len(part)
                columns = (empty if name in missing else part.column(name).to_pylist() for name in wanted.names)
                yield list(zip(*columns, strict=True))
    except NoEpisodes:
        raise
    except (pa.ArrowException, OSError, UnicodeError) as error:
        raise NoEpisodes("it is damaged") from error
