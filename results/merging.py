"""What merging and routing cost: experts, the merged policy told its task, and the same inferring it, pair by pair."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from results.record import Status
from results.routing import Rate, Router, router_of
from results.run import RunDocument
from results.statistics.pairs import Pairs, paired_difference, paired_ratio
from results.statistics.rates import Estimate
from suites.vocabulary import Condition

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    *("pair_id", "simulator", "task", "policy_digest", "axis", "severity", "status"),
    *("inferred_task", "routing_scores", "unknown_score", "rejected", "routing_s"),
)
"""Fields of the record that are needed."""
SEED = 20251118
"""Of the bootstrap, so that a report written again says the same."""


@dataclass(frozen=True, slots=True)
class Losses:
    """Success lost on the pairs in which expert, told and routed policy all have a verdict."""

    pairs: int
    errors: int
    """Pairs left out because a side ended in an error."""
    missing: int
    """Pairs left out because a side has no row."""
    merging: Estimate | None
    """Expert minus merged policy told its task."""
    routing: Estimate | None
    """Told minus routed."""
    total: Estimate | None
    """Expert minus routed: the sum of the two."""
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
    """Over its own verdicts, as everywhere else in a report."""
    told: Rate
    routed: Rate
    losses: Losses


@dataclass(frozen=True, slots=True)
class Regret:
    """What wrong choices cost."""

    misrouted: int
    """Pairs with a verdict of both sides in which the routed policy inferred another task than the true one."""
    lost: Estimate | None
    """Told minus routed on them."""


@dataclass(frozen=True, slots=True)
class RoutedComparison:
    """One routed policy beside the experts and the policy that is told its task."""

    policy: str
    tasks: tuple[MergingRow, ...]
    """In the order of the plan."""
    simulators: tuple[MergingRow, ...]
    overall: MergingRow
    router: Router | None
    """None if it never said what it inferred."""
    regret: Regret


@dataclass(frozen=True, slots=True)
class Merging:
    """The comparison that the suite's `merging` block asks for, under one condition."""

    expert: str
    told: str
    condition: Condition
    routed: tuple[RoutedComparison, ...]


def build_merging(document: RunDocument, frame: pd.DataFrame) -> Merging | None:
    """The comparison of a run, or None if its suite asks for none.

    Made under the clean condition, or the first of the plan if there is none.

    Args:
        document: Says which policies to compare, and what was planned.
        frame: Rows with the columns `COLUMNS`.
    """
    roles = document.merging
    if roles is None or not document.plan:
        return None
    conditions = dict.fromkeys(Condition(cell.axis, cell.severity) for cell in document.plan)
    condition = Condition() if Condition() in conditions else next(iter(conditions))
    rows = frame.loc[(frame["axis"].astype(str) == condition.axis) & (frame["severity"] == condition.severity)]
    digests = {cell.policy: cell.policy_digest for cell in document.plan}

    def side(name: str) -> pd.DataFrame:
        return rows.loc[rows["policy_digest"].astype(str) == digests.get(name)]

    tasks = _planned_tasks(document, roles.expert, condition)
    expert, told = side(roles.expert), side(roles.oracle_routed)
    routed = tuple(_compare(name, tasks, (expert, told, side(name))) for name in roles.routed)
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

    def judged(self) -> list[str]:
        """Pairs with a verdict of every side."""
        return [pair for pair in self.sides[0] if all(side.get(pair) in _VERDICTS for side in self.sides)]

    def errors(self) -> int:
        """Pairs in which a side ended in an error."""
        return len({pair for side in self.sides for pair, status in side.items() if status not in _VERDICTS})

    def counted(self, first: int, second: int) -> Pairs:
        """Outcomes of two of the sides on the judged pairs."""
        return _pairs(self.sides[first], self.sides[second], self.judged())


_VERDICTS = (str(Status.SUCCESS), str(Status.FAILURE))


def _planned_tasks(document: RunDocument, policy: str, condition: Condition) -> dict[str, tuple[str, int]]:
    """Task to its simulator and the pairs planned."""
    return {
        cell.task: (cell.simulator, cell.planned)
        for cell in document.plan
        if cell.policy == policy and Condition(cell.axis, cell.severity) == condition
    }


def _compare(
    policy: str, planned: Mapping[str, tuple[str, int]], frames: tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]
) -> RoutedComparison:
    expert, told, routed = (_outcomes(frame) for frame in frames)
    tasks = [
        _Task(simulator, name, number, (expert.get(name, {}), told.get(name, {}), routed.get(name, {})))
        for name, (simulator, number) in planned.items()
    ]
    simulators = dict.fromkeys(task.simulator for task in tasks)
    place = {name: number for number, name in enumerate(planned)}
    return RoutedComparison(
        policy=policy,
        tasks=tuple(_row([task], task.simulator, task.name) for task in tasks),
        simulators=tuple(_row([t for t in tasks if t.simulator == name], name, None) for name in simulators),
        overall=_row(tasks, None, None),
        router=router_of(frames[2].sort_values("task", key=lambda names: names.astype(str).map(place), kind="stable")),
        regret=_regret(tasks, frames[2]),
    )


def _outcomes(frame: pd.DataFrame) -> dict[str, dict[str, str]]:
    """Task to pair to status."""
    found: dict[str, dict[str, str]] = {}
    for task, pair, status in zip(frame["task"], frame["pair_id"], frame["status"], strict=True):
        found.setdefault(str(task), {})[str(pair)] = str(status)
    return found


def _row(tasks: Sequence[_Task], simulator: str | None, task: str | None) -> MergingRow:
    expert, told, routed = (_rate([t.sides[i] for t in tasks]) for i in range(3))
    return MergingRow(simulator, task, expert, told, routed, _losses(tasks))


def _rate(outcomes: Sequence[Outcomes]) -> Rate:
    counts = Counter(status for side in outcomes for status in side.values())
    return Rate.of(counts[_VERDICTS[0]], counts[_VERDICTS[0]] + counts[_VERDICTS[1]])


def _losses(tasks: Sequence[_Task]) -> Losses:
    import numpy as np

    pairs = sum(len(task.judged()) for task in tasks)
    errors = sum(task.errors() for task in tasks)
    return Losses(
        pairs=pairs,
        errors=errors,
        missing=max(sum(task.planned for task in tasks) - pairs - errors, 0),
        merging=paired_difference(_sum([task.counted(0, 1) for task in tasks])),
        routing=paired_difference(_sum([task.counted(1, 2) for task in tasks])),
        total=paired_difference(_sum([task.counted(0, 2) for task in tasks])),
        retention=paired_ratio([task.counted(2, 0) for task in tasks], np.random.default_rng(SEED)),
    )


def _pairs(first: Outcomes, second: Outcomes, pairs: Sequence[str]) -> Pairs:
    success = _VERDICTS[0]
    counts = Counter((first[pair] == success, second[pair] == success) for pair in pairs)
    return Pairs(counts[True, True], counts[True, False], counts[False, True], counts[False, False])


def _sum(parts: Sequence[Pairs]) -> Pairs:
    return Pairs(
        sum(p.both for p in parts),
        sum(p.first_only for p in parts),
        sum(p.second_only for p in parts),
        sum(p.neither for p in parts),
    )


def _regret(tasks: Sequence[_Task], routed: pd.DataFrame) -> Regret:
    named = routed.loc[routed["inferred_task"].notna()]
    wrong = named.loc[named["task"].astype(str) != named["inferred_task"].astype(str), "pair_id"]
    misrouted = set(wrong.astype(str))
    parts = []
    for task in tasks:
        told, inferring = task.sides[1], task.sides[2]
        both = [p for p in inferring if p in misrouted and inferring[p] in _VERDICTS and told.get(p) in _VERDICTS]
        parts.append(_pairs(told, inferring, both))
    counts = _sum(parts)
    return Regret(counts.trials, paired_difference(counts))
