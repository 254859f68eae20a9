"""Kinds of failures of a policy from run to run, read from the rows of the runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass

import sqlalchemy as sa

from robogauntlet.results.record import FailureKind, Status
from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.database import StoreError
from robogauntlet.results.store.episode_store import Store
from robogauntlet.results.store.history_records import PolicyRunResult, rows_url
from robogauntlet.results.store.schema import episodes

MOST_RUNS = 30
"""Runs whose rows are read, the newest."""


@dataclass(frozen=True)
class RunKinds:
    """The failures of a policy in a run by kind."""

    result: PolicyRunResult
    kinds: Mapping[FailureKind, int]
    """Number of failures of each kind that occurs."""
    new: tuple[FailureKind, ...]
    """Kinds that no earlier run of the list with a known kind had; none in the first of these."""


def kinds_in_run(result: PolicyRunResult, history_url: str, task: str | None = None) -> Mapping[FailureKind, int]:
    """Count the kinds of a policy's failures in clean episodes; empty if the rows cannot be read or have none.

    `history_url` is the URL of the history with its password.
    """
    e = episodes.c
    query = sa.select(e.failure, sa.func.count()).where(
        *(e.run_id == result.run.run_id, e.policy_digest == result.policy_digest),
        *(e.severity == 0, e.status == str(Status.FAILURE), e.failure.is_not(None)),
    )
    if task is not None:
        query = query.where(e.task == task)
    try:
        url = rows_url(result.run, history_url)
        with closing(Store.open(url, result.run.run_id, create=False)) as store, store.database.reading() as connection:
            counted = {text: int(n) for text, n in connection.execute(query.group_by(e.failure))}
    except (RunError, StoreError):
        return {}
    return {kind: counted[kind] for kind in FailureKind if kind in counted}


def kinds_by_run(
    results: Iterable[PolicyRunResult], count: Callable[[PolicyRunResult], Mapping[FailureKind, int]]
) -> list[RunKinds]:
    """The runs with a known kind, oldest first as in `results`, of which the newest `MOST_RUNS` are read by `count`."""
    seen: set[FailureKind] = set()
    found = []
    for result in [*results][-MOST_RUNS:]:
        kinds = count(result)
        if kinds:
            found.append(RunKinds(result, kinds, tuple(kind for kind in kinds if seen and kind not in seen)))
            seen |= set(kinds)
    return found
