"""Reads columns of an `episodes.parquet` as a table."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.tables import CATEGORIES, COLUMNS

if TYPE_CHECKING:
    import pandas as pd


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
