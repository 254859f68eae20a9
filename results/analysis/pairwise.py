"""Comparison of policies with each other, in one run or in two, on the episodes that both played.

Episodes are paired by `pair_id` (task, condition, seed and protocol). Each comparison gives the difference of the
success rates with Newcombe's paired interval and McNemar's exact test: of clean episodes over all tasks, per simulator
and per task, and of perturbed ones per condition (`pairwise_conditions`). The p-values over all tasks are adjusted
together by Holm's method, and so are those of simulators and tasks, and those of each axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING

from robogauntlet.results.analysis import comparison, paired_behaviour
from robogauntlet.results.analysis.comparison import Difference, Run, setting_differences
from robogauntlet.results.analysis.leaderboard import MOST_POLICIES, LeaderboardRow, PolicyEpisodes, leaderboard
from robogauntlet.results.analysis.paired_behaviour import (
    BehaviourComparison,
    OutcomeChange,
    compare_behaviour,
    outcome_changes,
)
from robogauntlet.results.analysis.pairwise_conditions import (
    ConditionLine,
    adjusted_by_axis,
    condition_lines,
    perturbed_rows,
)
from robogauntlet.results.record import Status
from robogauntlet.results.run_document import RunDocument, RunError, RunStatus
from robogauntlet.results.statistics.multiplicity import ALPHA, holm
from robogauntlet.results.statistics.pairs import (
    Pairs,
    can_reject,
    detectable_drop,
    is_no_worse,
    mcnemar,
    paired_difference,
    pooled,
)
from robogauntlet.results.statistics.rates import Estimate
from robogauntlet.suites.plugins import did_you_mean

if TYPE_CHECKING:
    import pandas as pd

PROTOCOL = ("horizon", "replan_every", "cameras", "image_size", "render_profile", "protocol", "success_rule")
"""Fields of the record that have the protocol of an episode."""
OWN = {"protocol": "robogauntlet", "success_rule": "the protocol's own"}
"""What an empty field stands for."""
COLUMNS = (*comparison.COLUMNS, "axis", "severity", *PROTOCOL)
"""Fields of the record that a comparison needs."""
ALL_PAIRS = 4
"""Number of policies up to which every pair is compared; letters summarise the pairs of more."""
MOST_NAMED = 20
"""Pairs without a common episode that are named."""


class NotComparable(RunError):
    """Two policies that share no episode, or whose runs differ in more than the policy."""


@dataclass(frozen=True, slots=True)
class Side:
    """A policy of a run."""

    policy: str
    run: str
    """Name of the run."""
    policy_digest: str


@dataclass(frozen=True, eq=False)
class PolicyRows:
    """The episodes of a policy in a run, columns `COLUMNS`, errors included."""

    side: Side
    document: RunDocument
    rows: pd.DataFrame
    """The clean ones."""
    perturbed: pd.DataFrame

    @classmethod
    def of_run(cls, run: Run, policy: str) -> PolicyRows:
        """Select the rows of a policy by the digest of its content. Raises RunError if the run has no such policy."""
        digests = {cell.policy: cell.policy_digest for cell in run.document.plan}
        if policy not in digests:
            raise RunError(f"{run.name}: the run has no policy '{policy}'{did_you_mean(policy, digests)}")
        rows = run.rows
        own = rows[rows["policy_digest"] == digests[policy]]
        side = Side(policy, run.name, digests[policy])
        return cls(side, run.document, own[own["severity"] == 0], perturbed_rows(own))


@dataclass(frozen=True, slots=True)
class Line:
    """All tasks, the tasks of a simulator, or a task."""

    simulator: str | None
    """None for all tasks."""
    task: str | None
    """None for several tasks."""
    pairs: Pairs
    difference: Estimate
    """Success rate of the first policy minus that of the second, between -1 and 1, with a confidence of 1 - alpha."""
    p: float
    """McNemar's exact test, two-sided."""
    detectable: float | None
    """The smallest difference that this many pairs show with a probability of 0.8, see `pairs.detectable_drop`."""
    adjusted: float = 1.0
    """The p-value adjusted by Holm's method."""
    no_worse: bool | None = None
    """Whether the first is shown to be worse by less than the margin; None without a margin."""


@dataclass(frozen=True)
class PairwiseComparison:
    """A policy against another on the episodes that both played."""

    first: Side
    second: Side
    overall: Line
    simulators: tuple[Line, ...]
    """Simulators with several tasks, if there are several simulators."""
    tasks: tuple[Line, ...]
    identical: int
    """Clean pairs in which both policies executed the same actions."""
    errors: tuple[int, int]
    """Clean episodes of each that ended in an error; they are left out."""
    unpaired: tuple[int, int]
    """Clean episodes of each with a verdict, of which the other has no verdict; they are left out."""
    differences: Mapping[Difference, str] = field(default_factory=dict)
    """What else differs, in words."""
    conditions: tuple[ConditionLine, ...] = ()
    """Perturbed conditions, controls excepted; in none of the lines above."""
    perturbed_left_out: tuple[int, int] = (0, 0)
    """Perturbed episodes of each that are in no pair."""
    behaviour: BehaviourComparison | None = None
    """How they move and fail in clean episodes; None if that was not measured for both."""
    perturbed_changes: tuple[OutcomeChange, ...] = ()
    """Outcomes of the perturbed pairs in which a side failed."""

    @property
    def parts(self) -> tuple[Line, ...]:
        """The simulators and tasks that are tested; a single task is the line `overall`."""
        return (*self.simulators, *self.tasks) if len(self.tasks) > 1 else ()


@dataclass(frozen=True)
class PairwiseComparisons:
    """Policies compared with each other."""

    alpha: float
    """Significance level of the adjusted p-values; the confidence of intervals is 1 - alpha."""
    margin: float | None
    """Largest decrease of a rate that counts as no worse; None if that is not tested."""
    baseline: str | None
    """The policy with which the others are compared; None if any two are compared."""
    policies: int
    """Number of policies."""
    comparisons: tuple[PairwiseComparison, ...]
    """Empty for more than `ALL_PAIRS` policies without a baseline."""
    standings: tuple[LeaderboardRow, ...] = ()
    """Three or more policies without a baseline, with letters: those that share one do not differ significantly."""
    not_compared: tuple[str, ...] = ()
    """Pairs of policies that were not compared, with the reason."""
    is_adaptive: bool = False
    """Whether the number of pairs depends on outcomes, for which the p-values are not made."""


def compare_policies(
    first: PolicyRows,
    second: PolicyRows,
    *,
    alpha: float = ALPHA,
    margin: float | None = None,
    allowed: Set[Difference] = frozenset(),
) -> PairwiseComparisons:
    """Compare a policy with another of the same run or of another run.

    Raises:
        NotComparable: They share no episode with a verdict of both, or their runs differ in what is not allowed.
        ValueError: alpha or margin outside (0, 1).
    """
    found = _adjusted([_compare(first, second, alpha, margin, allowed)], alpha)
    adaptive = any(side.document.suite.adaptive is not None for side in (first, second))
    return PairwiseComparisons(alpha, margin, None, 2, found, is_adaptive=adaptive)


def compare_all(
    run: Run, *, only: Sequence[str] = (), alpha: float = ALPHA, margin: float | None = None
) -> PairwiseComparisons:
    """Compare the policies of a run: with the baseline of its suite's `compare` or `merging`, else all pairs.

    `only` restricts the policies. Pairs that share no episode are in `not_compared`.

    Raises:
        RunError: Fewer than two policies, or an unknown one.
        ValueError: alpha or margin outside (0, 1).
    """
    names = list(only) or list(dict.fromkeys(cell.policy for cell in run.document.plan))
    sides = {name: PolicyRows.of_run(run, name) for name in names}
    if len(sides) < 2:
        raise RunError(f"{run.name}: expected two policies or more to compare, got {', '.join(sides) or 'none'}")
    baseline, pairs = _pairs(run.document, list(sides))
    compared, unnamed = [], 0
    failed: list[str] = []
    every = baseline is not None or len(sides) <= ALL_PAIRS
    if not every and len(sides) > MOST_POLICIES:
        pairs = []
    verdicts = {} if every else {name: _verdicts(side) for name, side in sides.items()}
    for one, other in pairs:
        if not every and not verdicts[one].isdisjoint(verdicts[other]):
            continue  # The letters summarise it.
        if len(failed) >= MOST_NAMED and verdicts:
            unnamed += 1
            continue
        try:
            compared.append(_compare(sides[one], sides[other], alpha, margin, frozenset(Difference)))
        except NotComparable as error:
            failed.append(str(error))
    if unnamed:
        failed.append(f"{unnamed:,} more pairs that share no episode")
    standings = leaderboard(list(map(_played, sides.values())), alpha) if baseline is None and len(sides) > 2 else []
    count = len(sides) if baseline is None else len(pairs) + 1
    return PairwiseComparisons(
        alpha,
        margin,
        baseline,
        count,
        _adjusted(compared, alpha),
        tuple(standings),
        tuple(failed),
        run.document.suite.adaptive is not None,
    )


def _pairs(document: RunDocument, names: Sequence[str]) -> tuple[str | None, list[tuple[str, str]]]:
    """The baseline of the suite's comparison, if it has one, and the pairs to compare."""
    sides = document.suite.comparison
    if sides is not None and sides.baseline in names:
        others = [name for name in dict.fromkeys(sides.others) if name in names]
        if others:
            return sides.baseline, [(name, sides.baseline) for name in others]
    return None, list(combinations(names, 2))


def _verdicts(one: PolicyRows) -> set[str]:
    """Pairs in which the policy succeeded or failed."""
    return set(_with_verdict(one.rows)["pair_id"])


def _played(one: PolicyRows) -> PolicyEpisodes:
    side = one.side
    return PolicyEpisodes(side.policy, side.policy_digest, side.run, one.document.started_at, one.rows)


def _compare(
    first: PolicyRows, second: PolicyRows, alpha: float, margin: float | None, allowed: Set[Difference]
) -> PairwiseComparison:
    sides = [_with_verdict(one.rows) for one in (first, second)]
    shared, perturbed = _paired(*sides), _paired(*(_with_verdict(one.perturbed) for one in (first, second)))
    names = " and ".join(f"{one.side.run}:{one.side.policy}" for one in (first, second))
    if shared.empty:
        raise NotComparable(f"{names} share no episode: {_why_none(first, second)}")
    unfinished = [f"{one.side.run} is {one.document.status}" for one in (first, second) if _is_unfinished(one)]
    differences = {Difference.UNFINISHED: ", ".join(dict.fromkeys(unfinished))} if unfinished else {}
    settings = setting_differences(first.document, second.document, shared)
    for kind, words in settings.items():
        if kind not in allowed:
            raise NotComparable(f"{names} are not comparable: {kind} differs: {words}; --allow {kind} compares them")
    tasks = _tasks(shared, first.document, alpha, margin)
    errors = [int((one.rows["status"] == str(Status.ERROR)).sum()) for one in (first, second)]
    return PairwiseComparison(
        first=first.side,
        second=second.side,
        overall=_line(None, None, pooled(line.pairs for line in tasks), alpha, margin),
        simulators=_simulators(tasks, alpha, margin),
        tasks=tasks,
        identical=int((shared["actions_hash"] == shared["actions_hash_before"]).sum()),
        errors=(errors[0], errors[1]),
        unpaired=(len(sides[0]) - len(shared), len(sides[1]) - len(shared)),
        differences=differences | settings,
        conditions=condition_lines(perturbed, first.document, alpha),
        behaviour=compare_behaviour(shared, alpha, (first.side.policy, second.side.policy)),
        perturbed_changes=outcome_changes(perturbed),
        perturbed_left_out=(len(first.perturbed) - len(perturbed), len(second.perturbed) - len(perturbed)),
    )


def _with_verdict(rows: pd.DataFrame) -> pd.DataFrame:
    return rows[rows["status"] != str(Status.ERROR)]


def _paired(first: pd.DataFrame, second: pd.DataFrame) -> pd.DataFrame:
    return first.merge(second, on="pair_id", suffixes=("", "_before"))


def _is_unfinished(one: PolicyRows) -> bool:
    return one.document.status is not RunStatus.COMPLETE


def _tasks(shared: pd.DataFrame, document: RunDocument, alpha: float, margin: float | None) -> tuple[Line, ...]:
    """A line per task, by simulator in the order of the plan."""
    tasks = {str(task): own for task, own in shared.groupby("task", sort=False, observed=True)}
    order = list(dict.fromkeys([*(cell.task for cell in document.plan), *tasks]))
    simulators = list(dict.fromkeys(map(_simulator, order)))
    lines = []
    for task in sorted(tasks, key=lambda task: (simulators.index(_simulator(task)), order.index(task))):
        won = (tasks[task][column] == str(Status.SUCCESS) for column in ("status", "status_before"))
        pairs = Pairs.from_outcomes(*(side.to_numpy(float) for side in won))
        lines.append(_line(_simulator(task), task, pairs, alpha, margin))
    return tuple(lines)


def _simulator(task: str) -> str:
    return task.partition("/")[0]


def _simulators(tasks: Sequence[Line], alpha: float, margin: float | None) -> tuple[Line, ...]:
    own: dict[str | None, list[Pairs]] = {}
    for line in tasks:
        own.setdefault(line.simulator, []).append(line.pairs)
    if len(own) < 2:
        return ()
    return tuple(_line(name, None, pooled(pairs), alpha, margin) for name, pairs in own.items() if len(pairs) > 1)


def _line(simulator: str | None, task: str | None, pairs: Pairs, alpha: float, margin: float | None) -> Line:
    difference = paired_difference(pairs, 1 - alpha)
    assert difference is not None  # There is a pair.
    no_worse = None if margin is None else is_no_worse(pairs, margin, 1 - alpha)
    detectable = detectable_drop(pairs, alpha / 2)
    return Line(simulator, task, pairs, difference, mcnemar(pairs), detectable, no_worse=no_worse)


def _adjusted(compared: Sequence[PairwiseComparison], alpha: float) -> tuple[PairwiseComparison, ...]:
    """Add adjusted p-values: one family over all tasks, one of all simulators and tasks, one of each axis.

    Simulators and tasks whose test cannot reach alpha are not in the second family and have 1, see `pairs.can_reject`.
    """
    overall = holm([one.overall.p for one in compared])
    tested = [line for one in compared for line in one.parts if can_reject(line.pairs, alpha / 2)]
    found = dict(zip(map(id, tested), holm([line.p for line in tested]), strict=True))

    def with_p(lines: Sequence[Line], otherwise: float) -> tuple[Line, ...]:
        return tuple(replace(line, adjusted=found.get(id(line), otherwise)) for line in lines)

    adjusted = []
    conditions = adjusted_by_axis([one.conditions for one in compared], alpha)
    moved = paired_behaviour.adjusted([one.behaviour for one in compared])
    for one, p, shifts, behaviour in zip(compared, overall, conditions, moved, strict=True):
        otherwise = 1.0 if one.parts else p  # A single task is the line over all tasks.
        simulators, tasks = with_p(one.simulators, otherwise), with_p(one.tasks, otherwise)
        line = replace(one.overall, adjusted=p)
        with_tests = replace(one, overall=line, simulators=simulators, tasks=tasks, conditions=shifts)
        adjusted.append(replace(with_tests, behaviour=behaviour))
    return tuple(adjusted)


PLAY_ALIKE = "play both on the same tasks with the same seeds and protocol"


def _why_none(first: PolicyRows, second: PolicyRows) -> str:
    """Why two policies have no episode in common, in words."""
    sides = [_with_verdict(one.rows) for one in (first, second)]
    for one, rows in zip((first, second), sides, strict=True):
        if rows.empty:
            errors = f", {len(one.rows):,} ended in an error" if len(one.rows) else ""
            return f"{one.side.run}:{one.side.policy} has no clean episode with a verdict{errors}"
    values = [set(rows["task"]) for rows in sides]
    if not values[0] & values[1]:
        return f"tasks {_listed(values[0])} and {_listed(values[1])}; {PLAY_ALIKE}"
    of_both = [rows[rows["task"].isin(values[0] & values[1])] for rows in sides]
    found = []
    for name in PROTOCOL:
        values = [{_value(name, value) for value in set(rows[name])} for rows in of_both]
        if not values[0] & values[1]:
            found.append(f"{name} {_listed(values[0])} and {_listed(values[1])}")
    seeds = [set(rows["seed"]) for rows in of_both]
    if not seeds[0] & seeds[1]:
        found.append(f"seeds {_range(seeds[0])} and {_range(seeds[1])}")
    return "; ".join([*(found or ["no task was played by both with the same seed and protocol"]), PLAY_ALIKE])


def _value(name: str, value: object) -> object:
    return OWN[name] if name in OWN and not isinstance(value, str) else value


def _listed(values: Set[object]) -> str:
    shown = sorted(map(str, values))
    return ", ".join(shown[:3]) + (f" and {len(shown) - 3} more" if len(shown) > 3 else "")


def _range(seeds: Set[int]) -> str:
    return f"{min(seeds)} to {max(seeds)}" if len(seeds) > 1 else f"{min(seeds)}"
