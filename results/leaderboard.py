"""Policies across runs, side by side: rates with intervals, and letters instead of ranks.

Two policies that share a letter were not shown to differ: each pair of them is compared on the episodes that both
played (McNemar's exact test), all pairs together by Holm's method. The letters are the compact display of Piepho (2004,
Journal of Computational and Graphical Statistics 13), by insertion and absorption.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass
from itertools import combinations
from string import ascii_letters
from typing import TYPE_CHECKING

import numpy as np

from results.record import Status
from results.statistics.multiplicity import ALPHA, holm
from results.statistics.pairs import Pairs, mcnemar
from results.statistics.rates import Interval, wilson_interval

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("pair_id", "policy", "policy_digest", "task", "severity", "status")
"""Fields of the record that a leaderboard is made from."""


@dataclass(frozen=True)
class Standing:
    """A policy among the others."""

    policy: str
    policy_digest: str
    run: str
    """Name of the run that its episodes are from."""
    started_at: float
    """Of that run (seconds since 1970, UTC)."""
    successes: int
    verdicts: int
    rate: float
    """Mean over tasks: every task weighs the same."""
    interval: Interval | None
    """Wilson interval of the pooled rate, 95 %."""
    letters: str
    """Two that share one were not shown to differ."""


@dataclass(frozen=True)
class Played:
    """A policy's rows in one run."""

    policy: str
    policy_digest: str
    run: str
    started_at: float
    rows: pd.DataFrame
    """Columns `COLUMNS`, of this policy."""


def leaderboard(played: Sequence[Played], alpha: float = ALPHA) -> list[Standing]:
    """Set policies side by side, on clean episodes with a verdict.

    Args:
        played: The newest run of each policy, all of one suite. Runs that are incomplete have fewer pairs.
        alpha: Chance at most of any two policies getting no letter in common although they do not differ.

    Returns:
        The highest rate first, which says nothing beyond what the letters say.
    """
    judged = [_outcomes(one.rows) for one in played]
    order = sorted((i for i, rows in enumerate(judged) if len(rows)), key=lambda i: -_task_mean(judged[i]))
    pairs = list(combinations(order, 2))
    p_values = holm([_p_value(judged[a], judged[b]) for a, b in pairs]) if pairs else ()
    differ = {frozenset(pair) for pair, p in zip(pairs, p_values, strict=True) if p <= alpha}
    letters = compact_letters(order, differ)
    return [_standing(played[i], judged[i], letters[i]) for i in order]


def compact_letters(order: Sequence[int], differ: Set[frozenset[int]]) -> dict[int, str]:
    """Letters such that two share one if and only if they are not known to differ.

    Args:
        order: Whom to give letters, the first letters to the first.
        differ: Pairs that are known to differ.
    """
    columns: list[set[int]] = [set(order)]
    for pair in differ:
        split: list[set[int]] = []
        for column in columns:
            split += [column - {one} for one in pair] if pair <= column else [column]
        columns = [c for i, c in enumerate(split) if not any(_absorbs(split, i, j) for j in range(len(split)))]
    place = {one: number for number, one in enumerate(order)}
    columns.sort(key=lambda column: sorted(place[one] for one in column))
    names = [_letter(number) for number in range(len(columns))]
    return {one: "".join(name for name, column in zip(names, columns, strict=True) if one in column) for one in order}


def _absorbs(columns: Sequence[set[int]], i: int, j: int) -> bool:
    """Whether column j says everything that column i says."""
    return i != j and columns[i] <= columns[j] and (columns[i] != columns[j] or j < i)


def _letter(number: int) -> str:
    return ascii_letters[number] if number < len(ascii_letters) else f"({number})"


def _outcomes(rows: pd.DataFrame) -> pd.DataFrame:
    clean = rows[(rows["severity"] == 0) & (rows["status"] != str(Status.ERROR))]
    return clean.assign(won=clean["status"] == str(Status.SUCCESS))[["pair_id", "task", "won"]]


def _task_mean(rows: pd.DataFrame) -> float:
    return float(rows.groupby("task", observed=True)["won"].mean().mean())


def _p_value(one: pd.DataFrame, other: pd.DataFrame) -> float:
    both = one.merge(other, on="pair_id", suffixes=("", "_other"))
    if both.empty:
        return 1.0
    return mcnemar(Pairs.of(both["won"].to_numpy(np.float64), both["won_other"].to_numpy(np.float64)))


def _standing(one: Played, rows: pd.DataFrame, letters: str) -> Standing:
    won, count = int(rows["won"].sum()), len(rows)
    return Standing(
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
