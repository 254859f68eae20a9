"""Reads the newest results of each policy of a suite, for a leaderboard."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from robogauntlet.results.analysis.leaderboard import COLUMNS, PolicyEpisodes
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_frame import frame_of
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.history_records import rows_url
from robogauntlet.results.store.run_history import History
from robogauntlet.suites.episode import SuccessRule


def latest_results_per_policy(
    history: History, suite: str, left_out: Callable[[str], None], *, imported: bool = False
) -> Iterator[PolicyEpisodes]:
    """Yield the episodes of each policy of a suite in its newest complete run whose rows can be read.

    Those of one rule of success are compared, that of the newest run. `left_out` is called with a message for each run
    that counts otherwise, or whose rows cannot be read. With `imported`, runs of others count for policies that none
    played here has, and are named as such. Raises StoreError.
    """
    found: set[str] = set()
    rule: SuccessRule | None = None
    newest = history.newest_runs(suite, imported=imported)
    for entry, digests in sorted(newest, key=lambda run: run[0].imported):
        wanted = [name for name in digests if name not in found]
        if not wanted:
            continue
        try:
            own = history.document(entry.run_id).suite.success_rule
            rows = frame_of(Store.open(rows_url(entry, history.url), entry.run_id, create=False), COLUMNS)
        except (RunError, StoreError) as error:
            left_out(f"{entry.name} is left out: {error}")
            continue
        rule = rule or own
        if own is not rule:
            left_out(f"{entry.name} is left out: it counts success {own}, the newest run {rule}")
            continue
        for name in wanted:
            of_policy = rows[rows["policy"] == name]
            if len(of_policy):
                found.add(name)
                run = f"{entry.name} (imported)" if entry.imported else entry.name
                yield PolicyEpisodes(name, digests[name], run, entry.started_at, of_policy)
