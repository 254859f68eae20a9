"""Success lost by merging and by routing: experts, oracle-routed and routed policies, compared pair by pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.routing import Rate
from robogauntlet.results.record import Status
from robogauntlet.results.run_document import RunDocument
from robogauntlet.results.statistics.pairs import Pairs, paired_difference, paired_ratio
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.suites.episode import Condition

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("pair_id", "simulator", "task", "policy_digest", "axis", "severity", "status", "inferred_task")
"""Fields of the record that are needed."""
ROLES = ("expert", "oracle_routed", "routed")


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


@dataclass(frozen=True, eq=False)
class _Outcomes:
    """What each role made of each pair: tables with the columns `ROLES`, by task and pair."""

    won: pd.DataFrame
    """1 for a success, 0 for a failure, NaN without a verdict."""
    errors: pd.Series[bool]
    """Whether a role ended in an error."""
    planned: Mapping[str, tuple[str, int]]
    """Task to its simulator and number of planned pairs."""

    @classmethod
    def of_frames(cls, frames: Sequence[pd.DataFrame], planned: Mapping[str, tuple[str, int]]) -> _Outcomes:
        """Collect the outcomes of the planned tasks from the rows of each role."""
        import pandas as pd

        sides = [frame[["task", "pair_id", "status"]].astype(str) for frame in frames]
        sides = [side[side["task"].isin(list(planned))].set_index(["task", "pair_id"])["status"] for side in sides]
        statuses = pd.concat(sides, axis=1, keys=ROLES)
        verdicts = statuses.isin([str(Status.SUCCESS), str(Status.FAILURE)])
        won = (statuses == str(Status.SUCCESS)).astype(float).where(verdicts)
        return cls(won, (statuses.notna() & ~verdicts).any(axis=1), planned)

    def pairs(self, first: str, second: str, tasks: Sequence[str]) -> Pairs:
        """Outcomes of two roles on the pairs of these tasks that have a verdict of every role."""
        own = self.won[self.won.index.get_level_values("task").isin(tasks)].dropna()
        return Pairs.from_outcomes(own[first].to_numpy(), own[second].to_numpy())

    def row(self, tasks: Sequence[str], simulator: str | None, task: str | None) -> MergingRow:
        """The rates and losses of these tasks."""
        is_own = self.won.index.get_level_values("task").isin(tasks)
        own = (self.won.loc[is_own, role] for role in ROLES)
        expert, oracle_routed, routed = (Rate.from_counts(int(won.sum()), int(won.count())) for won in own)
        losses = self._losses(tasks, int(self.errors[is_own].sum()))
        return MergingRow(simulator, task, expert, oracle_routed, routed, losses)

    def _losses(self, tasks: Sequence[str], errors: int) -> Losses:
        expert, oracle_routed, routed = ROLES
        pairs = self.pairs(expert, routed, tasks)
        return Losses(
            pairs=pairs.trials,
            errors=errors,
            missing=max(sum(self.planned[task][1] for task in tasks) - pairs.trials - errors, 0),
            merging=paired_difference(self.pairs(expert, oracle_routed, tasks)),
            routing=paired_difference(self.pairs(oracle_routed, routed, tasks)),
            total=paired_difference(pairs),
            retention=paired_ratio(self.pairs(routed, expert, tasks)),
        )

    def regret(self, routed: pd.DataFrame) -> Regret:
        """What the routed policy lost where it inferred a wrong task."""
        named = routed[routed["inferred_task"].notna()]
        wrong = named.loc[named["task"].astype(str) != named["inferred_task"].astype(str), "pair_id"].astype(str)
        own = self.won[self.won.index.get_level_values("pair_id").isin(wrong)].dropna(subset=list(ROLES[1:]))
        pairs = Pairs.from_outcomes(*(own[role].to_numpy() for role in ROLES[1:]))
        return Regret(pairs.trials, paired_difference(pairs))


def _compare(policy: str, planned: Mapping[str, tuple[str, int]], frames: Sequence[pd.DataFrame]) -> RoutedComparison:
    outcomes = _Outcomes.of_frames(frames, planned)
    simulators: dict[str, list[str]] = {}
    for task, (simulator, _) in planned.items():
        simulators.setdefault(simulator, []).append(task)
    return RoutedComparison(
        policy=policy,
        tasks=tuple(outcomes.row([task], simulator, task) for task, (simulator, _) in planned.items()),
        simulators=tuple(outcomes.row(tasks, name, None) for name, tasks in simulators.items()),
        overall=outcomes.row(list(planned), None, None),
        regret=outcomes.regret(frames[2]),
    )
