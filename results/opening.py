"""Runs as notebooks want them: opened by their folder, rows as a table, two of them compared."""

from __future__ import annotations

from collections.abc import Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING

from results.comparison import COLUMNS, Comparison, Difference, Run, compare_runs
from results.record import FIELDS
from results.run import RunDocument, read_run
from results.store import Store
from results.tables import Tables, build_tables

if TYPE_CHECKING:
    import pandas as pd


class OpenRun:
    """A run folder."""

    def __init__(self, folder: Path, document: RunDocument, store: str | None) -> None:
        """See `open_run`."""
        self.folder, self.document, self._store = folder, document, store

    def __repr__(self) -> str:
        document = self.document
        return f"{self.folder}: suite {document.suite_name}, {document.planned:,} episodes planned, {document.status}"

    def episodes(self, fields: Sequence[str] = FIELDS) -> pd.DataFrame:
        """A row per episode; columns are the fields of `results.record.EpisodeResult`.

        Raises:
            RunError: They are in a database whose URL was not given.
            StoreError: The rows cannot be read.
        """
        return _frame(Store.open_begun(self.folder, self.document, self._store), fields)

    def tables(self) -> Tables:
        """Success per task, simulator and policy, with intervals: what the report shows."""
        return build_tables(self.document, self.episodes())


def read_episodes(url: str, run_id: str, fields: Sequence[str] = FIELDS) -> pd.DataFrame:
    """These fields of a run's rows, a row per episode.

    Args:
        url: Of the store that has them.
        run_id: The run.
        fields: Of `results.record.EpisodeResult`.

    Raises:
        StoreError: The rows cannot be read.
    """
    return _frame(Store.open(url, run_id), fields)


def _frame(rows: Store, fields: Sequence[str]) -> pd.DataFrame:
    import pandas as pd

    try:
        pieces = [pd.DataFrame(batch, columns=list(fields)) for batch in rows.batches(50_000, fields)]
    finally:
        rows.close()
    return pd.concat(pieces, ignore_index=True) if pieces else pd.DataFrame({name: [] for name in fields})


def open_run(folder: Path | str, store: str | None = None) -> OpenRun:
    """Open a run.

    Args:
        folder: Of the run.
        store: URL of its store, if that is not in the folder.

    Raises:
        RunError: The folder is no run.
    """
    return OpenRun(Path(folder), read_run(Path(folder)), store)


def compare(
    run: OpenRun | Path | str,
    baseline: OpenRun | Path | str,
    *,
    alpha: float | None = None,
    margin: float | None = None,
    only: Sequence[str] = (),
    allowed: Set[Difference] = frozenset(),
) -> Comparison:
    """Hold a run against an earlier one, see `results.comparison`. What is returned prints itself.

    Args:
        run: The newer one.
        baseline: The older one.
        alpha: Chance at most of a false alarm; None for what the run's suite says.
        margin: A rate that is lower by less than this counts as no worse; None for what the suite says.
        only: Names of policies; empty for all.
        allowed: Differences that do not forbid the comparison.

    Raises:
        RunError: A folder is no run.
        StoreError: Rows cannot be read.
    """
    sides = [one if isinstance(one, OpenRun) else open_run(one) for one in (run, baseline)]
    how = sides[0].document.regression
    return compare_runs(
        *(Run(one.folder.absolute().name, one.document, one.episodes(COLUMNS)) for one in sides),
        alpha=how.alpha if alpha is None else alpha,
        margin=how.margin if margin is None else margin,
        only=only,
        allowed=allowed,
    )
