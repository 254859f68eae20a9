"""Holds a run against the last good one of its suite, and writes down what came of it."""

from __future__ import annotations

from collections.abc import Sequence, Set
from pathlib import Path

from results.comparison import Comparison, Difference
from results.entries import RunEntry, rows_url
from results.history import History
from results.opening import OpenRun, compare
from results.report.comparison import reasons
from results.run import RunDocument, RunError


def judge(
    history: History,
    document: RunDocument,
    folder: Path,
    *,
    alpha: float | None = None,
    margin: float | None = None,
    only: Sequence[str] = (),
    allowed: Set[Difference] = frozenset(),
) -> Comparison | None:
    """Compare a run with its baseline; None if there is no earlier good run of its suite.

    What came of it is written into the history, unless it is of some policies only.

    Args:
        history: Knows the run and those before it.
        document: The run.
        folder: Its folder.
        alpha: See `results.opening.compare`.
        margin: See `results.opening.compare`.
        only: Names of policies; empty for all.
        allowed: Differences that do not forbid the comparison.

    Raises:
        RunError: Rows are where they cannot be reached.
        StoreError: Rows, or the history, cannot be read or written.
    """
    baseline = history.baseline(document)
    if baseline is None:
        return None
    own = RunEntry.of(document, folder)
    found = compare(
        opened(own, document, history),
        opened(baseline, history.document(baseline.run_id), history),
        alpha=alpha,
        margin=margin,
        only=only,
        allowed=allowed,
    )
    if not only:
        history.judge(document.run_id, str(found.verdict), baseline.run_id, reasons(found))
    return found


def opened(entry: RunEntry, document: RunDocument, history: History) -> OpenRun:
    """A run of the history, opened where its rows are.

    Raises:
        RunError: Its rows cannot be reached.
    """
    if entry.folder is None and entry.rows_url is None:
        raise RunError(f"{entry.name}: its folder is gone, and its rows with it")
    return OpenRun(Path(entry.folder or entry.name), document, rows_url(entry, history.url))
