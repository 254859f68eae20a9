"""Rows of a store as a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from robogauntlet.results.record import FIELDS, describe_fields
from robogauntlet.results.store.episode_store import Store

if TYPE_CHECKING:
    import pandas as pd
    import sqlalchemy as sa

_NUMBERS = tuple(name for name, (kind, nullable, _) in describe_fields().items() if nullable and kind in (int, float))
"""Fields that are numbers or missing. A column of them is `float64` with NaN, also if all are missing."""


def frame_of(store: Store, fields: Sequence[str] = FIELDS, *where: sa.ColumnElement[bool]) -> pd.DataFrame:
    """Read the rows of a store for which all of `where` holds, a column per field, and close it. Raises StoreError."""
    import pandas as pd

    try:
        types = {name: "float64" for name in fields if name in _NUMBERS}
        batches = store.batches(50_000, fields, *where)
        pieces = [pd.DataFrame(batch, columns=list(fields)).astype(types) for batch in batches]
    finally:
        store.close()
    return pd.concat(pieces, ignore_index=True) if pieces else pd.DataFrame({name: [] for name in fields})
