"""Each policy's newest rows of a suite: what a leaderboard is made from."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import sqlalchemy as sa

from results.database import StoreError
from results.entries import RunEntry, rows_url
from results.history import History
from results.leaderboard import COLUMNS, Played
from results.opening import read_episodes
from results.run import RunError
from results.schema import cells, runs

NEWEST = 500
"""Runs of a suite among which each policy's newest is looked for."""


def newest_played(history: History, suite: str, left_out: Callable[[str], None]) -> Iterator[Played]:
    """Each policy's rows in the newest complete run that has it and can be read.

    Args:
        history: Where the runs are.
        suite: Of which suite.
        left_out: Told in a line of each run whose rows cannot be read; an older one takes its place.

    Raises:
        StoreError: The history cannot be read.
    """
    found: set[str] = set()
    for entry, digests in newest_runs(history, suite):
        wanted = [name for name in digests if name not in found]
        if not wanted:
            continue
        try:
            rows = read_episodes(rows_url(entry, history.url), entry.run_id, COLUMNS)
        except (RunError, StoreError) as error:
            left_out(f"{entry.name} is left out: {error}")
            continue
        for name in wanted:
            own = rows[rows["policy"] == name]
            if len(own):
                found.add(name)
                yield Played(name, digests[name], entry.name, entry.started_at, own)


def newest_runs(history: History, suite: str) -> list[tuple[RunEntry, dict[str, str]]]:
    """The newest complete runs of a suite, each with its policies' digests by name; the newest first.

    Raises:
        StoreError: The history cannot be read.
    """
    complete = sa.select(runs.c.run_id).where(runs.c.suite == suite, runs.c.status == "complete")
    newest = complete.order_by(runs.c.started_at.desc()).limit(NEWEST)
    query = sa.select(cells.c.run_id, cells.c.policy, cells.c.policy_digest).where(cells.c.run_id.in_(newest))
    digests: dict[str, dict[str, str]] = {}
    with history.database.reading() as connection:
        for run_id, policy, digest in connection.execute(query.distinct()):
            digests.setdefault(run_id, {})[policy] = digest
    return [(entry, digests[entry.run_id]) for entry in history.entries(newest) if entry.run_id in digests]
