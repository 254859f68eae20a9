"""Compares a run with its baseline run, and records the verdict."""

from __future__ import annotations

from collections.abc import Sequence, Set
from pathlib import Path

from robogauntlet.results.analysis.comparison import Difference, RunComparison
from robogauntlet.results.api import compare, open_entry
from robogauntlet.results.report.comparison import reasons
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.store.history_records import RunEntry
from robogauntlet.results.store.run_history import History


def check_regression(
    history: History,
    document: RunDocument,
    folder: Path,
    *,
    alpha: float | None = None,
    margin: float | None = None,
    only: Sequence[str] = (),
    allowed: Set[Difference] = frozenset(),
) -> RunComparison | None:
    """Compare a run with its baseline, the last good run of its suite; None if there is no baseline.

    The verdict is written into the history, unless only some policies are compared. For the options see
    `robogauntlet.results.api.compare`.

    Raises:
        RunError: The rows cannot be reached from here.
        StoreError: The rows or the history cannot be read or written.
    """
    baseline = history.baseline(document)
    if baseline is None:
        return None
    comparison = compare(
        open_entry(history, RunEntry.from_document(document, folder), document),
        open_entry(history, baseline),
        alpha=alpha,
        margin=margin,
        only=only,
        allowed=allowed,
    )
    if not only:
        history.write_verdict(document.run_id, str(comparison.verdict), baseline.run_id, reasons(comparison))
    return comparison
