"""Queries of the history that only the dashboard needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from robogauntlet.results.store.history_records import RunEntry
from robogauntlet.results.store.run_history import History
from robogauntlet.results.store.schema import cells, runs

RECENT = 50
"""Number of runs, the newest, in which the tasks of a policy are searched."""


@dataclass(frozen=True)
class Filter:
    """Selection of runs; None means no restriction."""

    suite: str | None = None
    status: str | None = None
    policy: str | None = None
    scheduled: bool = False
    """Only runs that a schedule started."""

    def of(self, query: Any) -> Any:
        """Add the restrictions to a query."""
        if self.suite is not None:
            query = query.where(runs.c.suite == self.suite)
        if self.status is not None:
            query = query.where(runs.c.status == self.status)
        if self.policy is not None:
            query = query.where(sa.exists().where(cells.c.run_id == runs.c.run_id, cells.c.policy == self.policy))
        if self.scheduled:
            query = query.where(runs.c.schedule.is_not(None))
        return query


def page_of_runs(history: History, wanted: Filter, limit: int, offset: int) -> list[RunEntry]:
    """Return runs, the newest first. Raises StoreError."""
    query = wanted.of(sa.select(runs.c.run_id)).order_by(runs.c.started_at.desc(), runs.c.run_id)
    return history.entries(query.limit(limit).offset(offset))


def count_runs(history: History, wanted: Filter) -> int:
    """Return the number of runs. Raises StoreError."""
    with history.database.reading() as connection:
        return int(connection.scalar(wanted.of(sa.select(sa.func.count()).select_from(runs))) or 0)


def run_of(history: History, run_id: str) -> RunEntry | None:
    """Return the run with exactly this id, or None. Raises StoreError."""
    entries = history.entries(sa.select(runs.c.run_id).where(runs.c.run_id == run_id))
    return entries[0] if entries else None


def statuses(history: History) -> dict[str, int]:
    """Return the number of runs of each status. Raises StoreError."""
    query = sa.select(runs.c.status, sa.func.count()).where(runs.c.status.is_not(None)).group_by(runs.c.status)
    with history.database.reading() as connection:
        return {row[0]: row[1] for row in connection.execute(query.order_by(runs.c.status))}


def compared_runs(history: History, limit: int) -> list[RunEntry]:
    """Return runs that were compared with a baseline run, the newest first. Raises StoreError."""
    query = sa.select(runs.c.run_id).where(runs.c.verdict.is_not(None))
    return history.entries(query.order_by(runs.c.started_at.desc()).limit(limit))


def last_verdicts(history: History) -> dict[str, str]:
    """Return the verdict of each suite's newest run that has one. Raises StoreError."""
    newest = sa.select(runs.c.suite, sa.func.max(runs.c.started_at).label("at")).where(runs.c.verdict.is_not(None))
    last = newest.group_by(runs.c.suite).subquery()
    query = sa.select(runs.c.suite, runs.c.verdict).join(
        last, sa.and_(runs.c.suite == last.c.suite, runs.c.started_at == last.c.at)
    )
    with history.database.reading() as connection:
        return {row[0]: row[1] for row in connection.execute(query.where(runs.c.verdict.is_not(None)))}


def tasks(history: History, policy: str | None = None, suite: str | None = None) -> list[str]:
    """Return the tasks of the newest runs, or of those with a policy or of a suite. Raises StoreError."""
    newest = Filter(suite=suite, policy=policy).of(sa.select(runs.c.run_id))
    newest = newest.order_by(runs.c.started_at.desc()).limit(RECENT)
    query = sa.select(cells.c.task).distinct().where(cells.c.run_id.in_(newest)).order_by(cells.c.task)
    with history.database.reading() as connection:
        return list(connection.scalars(query))


def policies_of_runs(history: History, run_ids: Sequence[str]) -> dict[str, list[str]]:
    """Return the policies of each of these runs, by name. Raises StoreError."""
    query = sa.select(cells.c.run_id, cells.c.policy).distinct().where(cells.c.run_id.in_(run_ids))
    found: dict[str, list[str]] = {}
    with history.database.reading() as connection:
        for run_id, policy in connection.execute(query.order_by(cells.c.policy)):
            found.setdefault(run_id, []).append(policy)
    return found


def check_readable(history: History) -> None:
    """Read one run id. Raises StoreError if the history cannot be read."""
    with history.database.reading() as connection:
        connection.execute(sa.select(runs.c.run_id).limit(1)).all()
