"""Leaderboard of policies across runs: rates with intervals, and letters instead of ranks.

Two policies that share a letter do not differ significantly: each pair of policies is compared on the episodes that
both played (McNemar's exact test, adjusted over all pairs by Holm's method). The letters are the compact display of
Piepho (2004, Journal of Computational and Graphical Statistics 13), by insertion and absorption.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from itertools import combinations
from string import ascii_letters
from typing import TYPE_CHECKING

import numpy as np

from robogauntlet.results.analysis.unpaired import by_task as counts_by_task, states_known
from robogauntlet.results.record import Status
from robogauntlet.results.statistics.multiplicity import ALPHA, holm
from robogauntlet.results.statistics.pairs import Pairs, mcnemar
from robogauntlet.results.statistics.rates import Interval, wilson_interval
from robogauntlet.results.statistics.separate_trials import fisher

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("pair_id", "state_hash", "policy", "policy_digest", "task", "severity", "status")
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
    """Share of successes."""
    interval: Interval | None
    """Its Wilson interval, 95 %."""
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
    import pandas as pd

    clean = pd.concat([_outcomes(one.rows).assign(place=place) for place, one in enumerate(played)] or [pd.DataFrame()])
    if clean.empty:
        return []
    by_task = clean.groupby("task", observed=True)["place"].nunique()
    common = by_task.index[by_task == clean["place"].nunique()]
    clean = clean[clean["task"].isin(common)] if len(common) else clean
    won = clean.groupby("place")["won"]
    order = won.mean().sort_values(ascending=False, kind="stable").index.tolist()
    if len(order) > MOST_POLICIES:
        letters = dict.fromkeys(order, f"left out: more than {MOST_POLICIES} policies")
    else:
        pairs = list(combinations(order, 2))
        p_values = holm(_p_values(clean, pairs, [one.rows for one in played])) if pairs else ()
        differ = {frozenset(pair) for pair, p in zip(pairs, p_values, strict=True) if p <= alpha}
        letters = compact_letters(order, differ)
    found = []
    for i in order:
        one, successes, count = played[i], int(won.sum()[i]), int(won.count()[i])
        about = one.policy, one.policy_digest, one.run, one.started_at, successes, count, successes / count
        found.append(LeaderboardRow(*about, wilson_interval(successes, count), letters[i]))
    return found


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
    return clean.assign(won=clean["status"] == str(Status.SUCCESS))[["pair_id", "state_hash", "task", "won"]]


def _p_values(outcomes: pd.DataFrame, pairs: Sequence[tuple[int, int]], rows: Sequence[pd.DataFrame]) -> list[float]:
    """McNemar's test of each pair of policies on the episodes of both from the same state; 1 if there are none.

    Where the start states of one of them are not known, Fisher's test of their separate trials, stratified by task.
    """
    table = outcomes.pivot(index="place", columns=["pair_id", "state_hash"], values="won")
    won, lost = ((table == is_won).to_numpy(np.float64) for is_won in (True, False))
    # Episodes that the first solved and the second did not.
    better, place = (won @ lost.T).astype(int), table.index.get_indexer
    known = [states_known(own) for own in rows]
    clean = [own[(own["severity"] == 0) & own["task"].isin(set(outcomes["task"]))] for own in rows]
    return [
        mcnemar(Pairs(0, int(better[a, b]), int(better[b, a]), 0))
        if known[one] and known[other]
        else fisher(counts_by_task(clean[one], clean[other]).values())
        for (one, other), (a, b) in zip(pairs, map(place, pairs), strict=True)
    ]
