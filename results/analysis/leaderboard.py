"""Leaderboard of policies across runs: rates with intervals, and letters instead of ranks.

Two policies that share a letter do not differ significantly: each pair of policies is compared on the episodes that
both played (McNemar's exact test, adjusted over all pairs by Holm's method). The letters are the compact display of
Piepho (2004, Journal of Computational and Graphical Statistics 13), by insertion and absorption.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from string import ascii_letters
from typing import TYPE_CHECKING

import numpy as np

from robogauntlet.results.record import Status
from robogauntlet.results.statistics.multiplicity import ALPHA, holm
from robogauntlet.results.statistics.pairs import Pairs, mcnemar
from robogauntlet.results.statistics.rates import Interval, wilson_interval

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("pair_id", "policy", "policy_digest", "task", "severity", "status")
"""Fields of the record that are needed."""
MOST_POLICIES, MOST_LETTERS = 100, 100
"""Policies up to which pairs are compared, and letters up to which they are given: both may grow without end."""


@dataclass(frozen=True)
class LeaderboardRow:
    """A policy on the leaderboard."""

    policy: str
    policy_digest: str
    run: str
    """Name of the run with its episodes."""
    started_at: float
    """Start of that run (seconds since 1970, UTC)."""
    successes: int
    verdicts: int
    rate: float
    """Mean over tasks; tasks have equal weight."""
    interval: Interval | None
    """Wilson interval of the pooled rate, 95 %."""
    letters: str
    """Policies that share a letter do not differ significantly."""


@dataclass(frozen=True)
class PolicyEpisodes:
    """A policy's rows in one run."""

    policy: str
    policy_digest: str
    run: str
    started_at: float
    rows: pd.DataFrame
    """Columns `COLUMNS`, of this policy."""


def leaderboard(played: Sequence[PolicyEpisodes], alpha: float = ALPHA) -> list[LeaderboardRow]:
    """Rank the policies of a suite by success on clean episodes without an error, highest rate first.

    If they have played different tasks, those that all have played count, unless there are none. `alpha` is the maximum
    probability that any two policies that do not differ share no letter.
    """
    outcomes = [_outcomes(one.rows) for one in played]
    tasks = [set(rows["task"]) for rows in outcomes if len(rows)]
    if tasks and (common := set.intersection(*tasks)):
        outcomes = [rows[rows["task"].isin(common)] for rows in outcomes]
    order = sorted((i for i, rows in enumerate(outcomes) if len(rows)), key=lambda i: -_task_mean(outcomes[i]))
    if len(order) > MOST_POLICIES:
        return [_row(played[i], outcomes[i], f"left out: more than {MOST_POLICIES} policies") for i in order]
    pairs = list(combinations(order, 2))
    p_values = holm(_p_values(outcomes, pairs)) if pairs else ()
    differ = {frozenset(pair) for pair, p in zip(pairs, p_values, strict=True) if p <= alpha}
    letters = compact_letters(order, differ)
    return [_row(played[i], outcomes[i], letters[i]) for i in order]


def compact_letters(order: Sequence[int], differ: Set[frozenset[int]]) -> dict[int, str]:
    """Assign letters to policies in this order; two policies share none if and only if they differ significantly.

    All are `left out` if more than `MOST_LETTERS` are needed on the way.
    """
    columns: list[set[int]] = [set(order)]
    for pair in differ:
        kept = [column for column in columns if not pair <= column]
        for part in [column - {one} for column in columns if pair <= column for one in pair]:
            if not any(part <= other for other in kept):  # absorbed
                kept = [*(other for other in kept if not other < part), part]
        columns = kept
        if len(columns) > MOST_LETTERS:
            return dict.fromkeys(order, f"left out: more than {MOST_LETTERS} letters")
    place = {one: number for number, one in enumerate(order)}
    columns.sort(key=lambda column: sorted(place[one] for one in column))
    names = [ascii_letters[n] if n < len(ascii_letters) else f"({n})" for n in range(len(columns))]
    return {one: "".join(name for name, column in zip(names, columns, strict=True) if one in column) for one in order}


def _outcomes(rows: pd.DataFrame) -> pd.DataFrame:
    clean = rows[(rows["severity"] == 0) & (rows["status"] != str(Status.ERROR))]
    return clean.assign(won=clean["status"] == str(Status.SUCCESS))[["pair_id", "task", "won"]]


def _task_mean(rows: pd.DataFrame) -> float:
    return float(rows.groupby("task", observed=True)["won"].mean().mean())


def _p_values(outcomes: Sequence[pd.DataFrame], pairs: Sequence[tuple[int, int]]) -> list[float]:
    """McNemar's test of each pair of policies on the episodes of both; 1 if there are none."""
    import pandas as pd
    from scipy.sparse import csr_array

    policy = np.repeat(np.arange(len(outcomes)), [len(rows) for rows in outcomes])
    episode, known = pd.factorize(
        np.concatenate([rows["pair_id"].to_numpy(object) for rows in outcomes]), use_na_sentinel=False
    )
    won = np.concatenate([rows["won"].to_numpy(np.int64) for rows in outcomes])
    shape = len(outcomes), len(known)
    successes, failures = (csr_array((count, (policy, episode)), shape) for count in (won, 1 - won))
    better = (successes @ failures.T).toarray()  # episodes that the first solved and the second did not
    test = cache(mcnemar)
    return [test(Pairs(0, int(better[a, b]), int(better[b, a]), 0)) for a, b in pairs]


def _row(one: PolicyEpisodes, rows: pd.DataFrame, letters: str) -> LeaderboardRow:
    won, count = int(rows["won"].sum()), len(rows)
    return LeaderboardRow(
        policy=one.policy,
        policy_digest=one.policy_digest,
        run=one.run,
        started_at=one.started_at,
        successes=won,
        verdicts=count,
        rate=_task_mean(rows),
        interval=wilson_interval(won, count),
        letters=letters,
    )
