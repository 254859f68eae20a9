"""Reads the newest results of each policy of a suite, for a leaderboard."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from typing import TYPE_CHECKING

import sqlalchemy as sa

from robogauntlet.results.analysis.comparison import setting_differences
from robogauntlet.results.analysis.leaderboard import COLUMNS, PolicyEpisodes
from robogauntlet.results.run_document import RunDocument, RunError
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_frame import frame_of
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.history_records import rows_url
from robogauntlet.results.store.run_history import History
from robogauntlet.results.store.schema import episodes

if TYPE_CHECKING:
    import pandas as pd


def latest_results_per_policy(
    history: History, suite: str, left_out: Callable[[str], None], *, imported: bool = False
) -> Iterator[PolicyEpisodes]:
    """Yield the episodes of each policy of a suite in its newest complete run whose rows can be read.

    Only the rows that a leaderboard needs are read: clean ones, and those from states that are not known.
    `left_out` is called with a message for each run whose rows cannot be read, or that is not comparable with the
    newest run: it counts success otherwise, has other versions of simulators, another renderer or other start states.
    With `imported`, runs of others count for policies that none played here has, and are named as such. Raises
    StoreError.
    """
    import pandas as pd

    found: set[str] = set()
    first: tuple[RunDocument, pd.DataFrame] | None = None
    e, needed = episodes.c, sa.or_(episodes.c.severity == 0, episodes.c.state_hash == "")
    newest = history.newest_runs(suite, imported=imported)
    for entry, digests in sorted(newest, key=lambda run: run[0].imported):
        wanted = [name for name in digests if name not in found]
        if not wanted:
            continue
        try:
            document = history.document(entry.run_id)
            with closing(Store.open(rows_url(entry, history.url), entry.run_id, create=False)) as store:
                states = pd.DataFrame(store.start_states().items(), columns=["pair_id", "state_hash"])
                played = [name for name in wanted if store.has_rows(e.policy == name)]
                rows = frame_of(store, COLUMNS, e.policy.in_(played), needed)
        except (RunError, StoreError) as error:
            left_out(f"{entry.name} is left out: {error}")
            continue
        first = first or (document, states)
        if why := _why_not_comparable(first, (document, states)):
            left_out(f"{entry.name} is left out: {why}")
            continue
        run = f"{entry.name} (imported)" if entry.imported else entry.name
        for name in played:
            found.add(name)
            yield PolicyEpisodes(name, digests[name], run, entry.started_at, rows[rows["policy"] == name])


def _why_not_comparable(newest: tuple[RunDocument, pd.DataFrame], other: tuple[RunDocument, pd.DataFrame]) -> str:
    """Why the policies of a run are not compared with those of the newest; empty if they are."""
    (now, states), (before, states_before) = newest, other
    if now.suite.success_rule is not before.suite.success_rule:
        return f"it counts success {before.suite.success_rule}, the newest run {now.suite.success_rule}"
    found = setting_differences(now, before, states.merge(states_before, on="pair_id", suffixes=("", "_before")))
    return "; ".join(f"{kind} differs from the newest run: {words}" for kind, words in found.items())
