"""Success lost by merging and by routing: experts, oracle-routed and routed policies, compared pair by pair."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.routing import Rate
from robogauntlet.results.record import Status
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.statistics.pairs import Pairs, paired_difference, paired_ratio, pooled
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.suites.episode import Condition

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("pair_id", "simulator", "task", "policy_digest", "axis", "severity", "status", "inferred_task")
"""Fields of the record that are needed."""
SEED = 20251118
"""Seed of the bootstrap, so that reports are reproducible."""


@dataclass(frozen=True, slots=True)
class Losses:
    """Success lost, on pairs with a verdict of expert, oracle-routed and routed policy."""

    pairs: int
    errors: int
    """Pairs left out because of an error."""
    missing: int
    """Pairs left out because a row is missing."""
    merging: Estimate | None
    """Expert minus oracle-routed policy."""
    routing: Estimate | None
    """Oracle-routed minus routed policy."""
    total: Estimate | None
    """Expert minus routed policy: the sum of the two."""
    retention: Estimate | None
    """Routed successes per expert success."""


@dataclass(frozen=True, slots=True)
class MergingRow:
    """A task, a simulator, or all of them."""

    simulator: str | None
    """None for all simulators."""
    task: str | None
    """None for all tasks of the simulator."""
    expert: Rate
    """Over all verdicts of this policy, paired or not."""
    oracle_routed: Rate
    routed: Rate
    losses: Losses


@dataclass(frozen=True, slots=True)
class Regret:
    """Success lost by misrouting."""

    misrouted: int
    """Pairs with both verdicts in which the routed policy inferred a wrong task."""
    lost: Estimate | None
    """Oracle-routed minus routed policy on these pairs."""


@dataclass(frozen=True, slots=True)
class RoutedComparison:
    """One routed policy compared with the experts and the oracle-routed policy."""

    policy: str
    tasks: tuple[MergingRow, ...]
    """In the order of the plan."""
    simulators: tuple[MergingRow, ...]
    overall: MergingRow
    regret: Regret


@dataclass(frozen=True, slots=True)
class Merging:
    """The comparison of the suite's `merging` block, under one condition."""

    expert: str
    oracle_routed: str
    condition: Condition
    routed: tuple[RoutedComparison, ...]


def build_merging(document: RunDocument, frame: pd.DataFrame) -> Merging | None:
    """Compare the policies of a suite's `merging` block from rows with the columns `COLUMNS`; None without one.

    The condition is clean, or the first of the plan if clean is not planned.
    """
    roles = document.suite.merging
    if roles is None or not document.plan:
        return None
    conditions = dict.fromkeys(cell.condition for cell in document.plan)
    condition = Condition() if Condition() in conditions else next(iter(conditions))
    rows = frame.loc[(frame["axis"].astype(str) == condition.axis) & (frame["severity"] == condition.severity)]
    digests = {cell.policy: cell.policy_digest for cell in document.plan}

    def side(name: str) -> pd.DataFrame:
        return rows.loc[rows["policy_digest"].astype(str) == digests.get(name)]

    tasks = {
        cell.task: (cell.simulator, cell.planned)
        for cell in document.plan
        if cell.policy == roles.expert and cell.condition == condition
    }
    expert, oracle_routed = side(roles.expert), side(roles.oracle_routed)
    routed = tuple(_compare(name, tasks, (expert, oracle_routed, side(name))) for name in roles.routed)
    return Merging(roles.expert, roles.oracle_routed, condition, routed)


Outcomes = Mapping[str, str]
"""Pair to status."""


@dataclass(frozen=True, slots=True)
class _Task:
    """One task's outcomes on each side."""

    simulator: str
    name: str
    planned: int
    sides: tuple[Outcomes, Outcomes, Outcomes]

    def complete_pairs(self) -> list[str]:
        """Pairs with a verdict of every policy."""
        return [pair for pair in self.sides[0] if all(side.get(pair) in _VERDICTS for side in self.sides)]

    def errors(self) -> int:
        """Number of pairs with an error of a policy."""
        return len({pair for side in self.sides for pair, status in side.items() if status not in _VERDICTS})

    def pairs_of(self, first: int, second: int) -> Pairs:
        """Outcomes of two policies on the complete pairs."""
        return _pairs(self.sides[first], self.sides[second], self.complete_pairs())


_VERDICTS = (str(Status.SUCCESS), str(Status.FAILURE))


def _compare(
    policy: str, planned: Mapping[str, tuple[str, int]], frames: tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]
) -> RoutedComparison:
    expert, oracle_routed, routed = (_outcomes(frame) for frame in frames)
    tasks = [
        _Task(simulator, name, number, (expert.get(name, {}), oracle_routed.get(name, {}), routed.get(name, {})))
        for name, (simulator, number) in planned.items()
    ]
    simulators = dict.fromkeys(task.simulator for task in tasks)
    return RoutedComparison(
        policy=policy,
        tasks=tuple(_row([task], task.simulator, task.name) for task in tasks),
        simulators=tuple(_row([t for t in tasks if t.simulator == name], name, None) for name in simulators),
        overall=_row(tasks, None, None),
        regret=_regret(tasks, frames[2]),
    )


def _outcomes(frame: pd.DataFrame) -> dict[str, dict[str, str]]:
    """Task to pair to status."""
    found: dict[str, dict[str, str]] = {}
    for task, pair, status in zip(frame["task"], frame["pair_id"], frame["status"], strict=True):
        found.setdefault(str(task), {})[str(pair)] = str(status)
    return found


def _row(tasks: Sequence[_Task], simulator: str | None, task: str | None) -> MergingRow:
    expert, oracle_routed, routed = (_rate([t.sides[i] for t in tasks]) for i in range(3))
    return MergingRow(simulator, task, expert, oracle_routed, routed, _losses(tasks))


def _rate(outcomes: Sequence[Outcomes]) -> Rate:
    counts = Counter(status for side in outcomes for status in side.values())
    return Rate.from_counts(counts[_VERDICTS[0]], counts[_VERDICTS[0]] + counts[_VERDICTS[1]])


def _losses(tasks: Sequence[_Task]) -> Losses:
    import numpy as np

    pairs = sum(len(task.complete_pairs()) for task in tasks)
    errors = sum(task.errors() for task in tasks)
    return Losses(
        pairs=pairs,
        errors=errors,
        missing=max(sum(task.planned for task in tasks) - pairs - errors, 0),
        merging=paired_difference(pooled(task.pairs_of(0, 1) for task in tasks)),
        routing=paired_difference(pooled(task.pairs_of(1, 2) for task in tasks)),
        total=paired_difference(pooled(task.pairs_of(0, 2) for task in tasks)),
        retention=paired_ratio([task.pairs_of(2, 0) for task in tasks], np.random.default_rng(SEED)),
    )


def _pairs(first: Outcomes, second: Outcomes, pairs: Sequence[str]) -> Pairs:
    success = _VERDICTS[0]
    counts = Counter((first[pair] == success, second[pair] == success) for pair in pairs)
    return Pairs(counts[True, True], counts[True, False], counts[False, True], counts[False, False])


def _regret(tasks: Sequence[_Task], routed: pd.DataFrame) -> Regret:
    named = routed.loc[routed["inferred_task"].notna()]
    wrong = named.loc[named["task"].astype(str) != named["inferred_task"].astype(str), "pair_id"]
    misrouted, parts = set(wrong.astype(str)), []
    for task in tasks:
        sides = task.sides[1:]
        both = [pair for pair in sides[1] if pair in misrouted and all(side.get(pair) in _VERDICTS for side in sides)]
        parts.append(_pairs(*sides, both))
    counts = pooled(parts)
    return Regret(counts.trials, paired_difference(counts))
