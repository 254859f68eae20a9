"""Reads the newest results of each policy of a suite, for a leaderboard."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.comparison import setting_differences
from robogauntlet.results.analysis.leaderboard import COLUMNS, PolicyEpisodes
from robogauntlet.results.record import Status
from robogauntlet.results.run_document import RunDocument, RunError
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_frame import frame_of
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.history_records import rows_url
from robogauntlet.results.store.run_history import History

if TYPE_CHECKING:
    import pandas as pd


def latest_results_per_policy(
    history: History, suite: str, left_out: Callable[[str], None], *, imported: bool = False
) -> Iterator[PolicyEpisodes]:
    """Yield the episodes of each policy of a suite in its newest complete run whose rows can be read.

    `left_out` is called with a message for each run whose rows cannot be read, or that is not comparable with the
    newest run: it counts success otherwise, has other versions of simulators, another renderer or other start states.
    With `imported`, runs of others count for policies that none played here has, and are named as such. Raises
    StoreError.
    """
    found: set[str] = set()
    first: tuple[RunDocument, pd.DataFrame] | None = None
    newest = history.newest_runs(suite, imported=imported)
    for entry, digests in sorted(newest, key=lambda run: run[0].imported):
        wanted = [name for name in digests if name not in found]
        if not wanted:
            continue
        try:
            document = history.document(entry.run_id)
            rows = frame_of(Store.open(rows_url(entry, history.url), entry.run_id, create=False), COLUMNS)
        except (RunError, StoreError) as error:
            left_out(f"{entry.name} is left out: {error}")
            continue
        first = first or (document, rows)
        if why := _why_not_comparable(first, (document, rows)):
            left_out(f"{entry.name} is left out: {why}")
            continue
        for name in wanted:
            of_policy = rows[rows["policy"] == name]
            if len(of_policy):
                found.add(name)
                run = f"{entry.name} (imported)" if entry.imported else entry.name
                yield PolicyEpisodes(name, digests[name], run, entry.started_at, of_policy)


def _why_not_comparable(newest: tuple[RunDocument, pd.DataFrame], other: tuple[RunDocument, pd.DataFrame]) -> str:
    """Why the policies of a run are not compared with those of the newest; empty if they are."""
    (now, rows), (before, rows_before) = newest, other
    if now.suite.success_rule is not before.suite.success_rule:
        return f"it counts success {before.suite.success_rule}, the newest run {now.suite.success_rule}"
    states = [one[one["status"] != str(Status.ERROR)].drop_duplicates("pair_id") for one in (rows, rows_before)]
    pairs = states[0].merge(states[1], on="pair_id", suffixes=("", "_before"))
    found = setting_differences(now, before, pairs)
    return "; ".join(f"{kind} differs from the newest run: {words}" for kind, words in found.items())
