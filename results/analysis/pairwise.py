"""Comparison of policies with each other, in one run or in two, on the episodes that both played.

Episodes are paired by `pair_id` (task, condition, seed and protocol). Each comparison gives the difference of the
success rates with Newcombe's paired interval and McNemar's exact test: of clean episodes over all tasks, per simulator
and per task, and of perturbed ones per condition, the pairs of all tasks added up. Severities are not added up: they
start from the same seeds, so that their pairs are not independent. The p-values over all tasks are adjusted together by
Holm's method, and so are those of simulators and tasks, and those of each axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING

from robogauntlet.results.analysis import comparison
from robogauntlet.results.analysis.comparison import (
    Comparison,
    Difference,
    PolicyComparison,
    Run,
    Side,
    same_actions,
    setting_differences,
)
from robogauntlet.results.analysis.contrasts import (
    OUTCOMES,
    Contrast,
    Question,
    all_pairs,
    by_condition,
    by_simulator,
    by_task,
    contrasts,
)
from robogauntlet.results.analysis.leaderboard import MOST_POLICIES, LeaderboardRow, PolicyEpisodes, leaderboard
from robogauntlet.results.analysis.paired_behaviour import (
    BehaviourComparison,
    adjusted,
    compare_behaviour,
    outcome_changes,
)
from robogauntlet.results.analysis.unpaired import (
    UnpairedComparison,
    adjusted as adjusted_unpaired,
    compare_unpaired,
    states_known,
)
from robogauntlet.results.record import Status
from robogauntlet.results.run_document import RunDocument, RunError, RunStatus
from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.suites.episode import AT, CONTROLS
from robogauntlet.suites.plugins import did_you_mean

if TYPE_CHECKING:
    import pandas as pd

PROTOCOL = ("horizon", "replan_every", "cameras", "image_size", "render_profile", "protocol", "success_rule", "timing")
"""Fields of the record that have the protocol of an episode."""
OWN = {"protocol": "robogauntlet", "success_rule": "the protocol's own", "timing": "waits"}
"""What an empty field stands for."""
COLUMNS = (*comparison.COLUMNS, "axis", "severity", *PROTOCOL)
"""Fields of the record that a comparison of policies needs."""
ALL_PAIRS = 4
"""Number of policies up to which every pair is compared; letters summarise the pairs of more."""
MOST_NAMED = 20
"""Pairs without a common episode that are named."""


class NotComparable(RunError):
    """Two policies that share no episode, or whose runs differ in more than the policy."""


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


@dataclass(frozen=True, kw_only=True)
class PolicyComparisons(Comparison):
    """Policies compared with each other; the confidence of intervals is 1 - alpha."""

    policies: int
    """Number of policies. More than `ALL_PAIRS` without a baseline are not in `comparisons`."""
    standings: tuple[LeaderboardRow, ...] = ()
    """Three or more policies without a baseline, with letters: those that share one do not differ significantly."""
    not_compared: tuple[str, ...] = ()
    """Pairs of policies that were not compared, with the reason."""
    unpaired: tuple[UnpairedComparison, ...] = ()
    """Those of policies whose start states are not known, which are in nothing above but `standings`."""
    is_adaptive: bool = False
    """Whether the number of pairs depends on outcomes, for which the p-values are not made."""


def compare_policies(
    first: PolicyRows,
    second: PolicyRows,
    *,
    alpha: float = ALPHA,
    margin: float | None = None,
    allowed: Set[Difference] = frozenset(),
) -> PolicyComparisons:
    """Compare a policy with another of the same run or of another run.

    Raises:
        NotComparable: They share no episode with a verdict of both, or their runs differ in what is not allowed.
        ValueError: alpha or margin outside (0, 1).
    """
    if (separate := _unpaired(first, second, alpha)) is not None:
        return PolicyComparisons(
            alpha=alpha, margin=margin, baseline=None, policies=2, comparisons=(), unpaired=(separate,)
        )
    found = _contrasted([_paired(first, second, alpha, allowed)], first.document, alpha, margin)
    adaptive = any(side.document.suite.adaptive is not None for side in (first, second))
    return PolicyComparisons(
        alpha=alpha, margin=margin, baseline=None, policies=2, comparisons=found, is_adaptive=adaptive
    )


def compare_all(
    run: Run, *, only: Sequence[str] = (), alpha: float = ALPHA, margin: float | None = None
) -> PolicyComparisons:
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
    compared, separate, unnamed = [], [], 0
    failed: list[str] = []
    every = baseline is not None or len(sides) <= ALL_PAIRS
    if not every and len(sides) > MOST_POLICIES:
        pairs = []
    verdicts = {} if every else {name: set(_with_verdict(side.rows)["pair_id"]) for name, side in sides.items()}
    for one, other in pairs:
        if (apart := _unpaired(sides[one], sides[other], alpha)) is not None:
            separate += [apart] if every else []
            continue
        if not every and not verdicts[one].isdisjoint(verdicts[other]):
            continue  # The letters summarise it.
        if len(failed) >= MOST_NAMED and verdicts:
            unnamed += 1
            continue
        try:
            compared.append(_paired(sides[one], sides[other], alpha, frozenset(Difference)))
        except NotComparable as error:
            failed.append(str(error))
    if unnamed:
        failed.append(f"{unnamed:,} more pairs that share no episode")
    standings: Sequence[LeaderboardRow] = ()
    if baseline is None and len(sides) > 2:
        started = run.document.started_at
        standings = leaderboard(
            [
                PolicyEpisodes(one.side.policy, one.side.policy_digest, run.name, started, one.rows)
                for one in sides.values()
            ],
            alpha,
        )
    count = len(sides) if baseline is None else len(pairs) + 1
    return PolicyComparisons(
        alpha=alpha,
        margin=margin,
        baseline=baseline,
        policies=count,
        comparisons=_contrasted(compared, run.document, alpha, margin),
        standings=tuple(standings),
        not_compared=tuple(failed),
        unpaired=adjusted_unpaired(separate),
        is_adaptive=run.document.suite.adaptive is not None,
    )


def _pairs(document: RunDocument, names: Sequence[str]) -> tuple[str | None, list[tuple[str, str]]]:
    """The baseline of the suite's comparison, if it has one, and the pairs to compare."""
    sides = document.suite.comparison
    if sides is not None and sides.baseline in names:
        others = [name for name in dict.fromkeys(sides.others) if name in names]
        if others:
            return sides.baseline, [(name, sides.baseline) for name in others]
    return None, list(combinations(names, 2))


@dataclass(frozen=True, eq=False)
class _Paired:
    """Two policies of which the contrasts are not made yet."""

    complete: Callable[..., PolicyComparison]
    """Makes the comparison from `overall`, `simulators`, `tasks`, `conditions` and `behaviour`."""
    behaviour: BehaviourComparison | None
    clean: pd.DataFrame
    perturbed: pd.DataFrame


def _paired(first: PolicyRows, second: PolicyRows, alpha: float, allowed: Set[Difference]) -> _Paired:
    sides = [_with_verdict(one.rows) for one in (first, second)]
    clean = _merged(*sides)
    names = " and ".join(f"{one.side.run}:{one.side.policy}" for one in (first, second))
    if clean.empty:
        raise NotComparable(f"{names} share no episode: {_why_none(first, second)}")
    states = dict.fromkeys((one.side.run, one.document.status) for one in (first, second))
    unfinished = ", ".join(f"{run} is {state}" for run, state in states if state is not RunStatus.COMPLETE)
    differences = {Difference.UNFINISHED: unfinished} if unfinished else {}
    settings = setting_differences(first.document, second.document, clean)
    for kind, words in settings.items():
        if kind not in allowed:
            raise NotComparable(f"{names} are not comparable: {kind} differs: {words}; --allow {kind} compares them")
    perturbed = _merged(*(_with_verdict(one.perturbed) for one in (first, second)))
    errors = [int((one.rows["status"] == str(Status.ERROR)).sum()) for one in (first, second)]
    complete = partial(
        PolicyComparison,
        first=first.side,
        second=second.side,
        identical=same_actions(clean),
        errors=(errors[0], errors[1]),
        unpaired=(len(sides[0]) - len(clean), len(sides[1]) - len(clean)),
        differences=differences | settings,
        perturbed_changes=outcome_changes(perturbed),
        perturbed_left_out=(len(first.perturbed) - len(perturbed), len(second.perturbed) - len(perturbed)),
    )
    behaviour = compare_behaviour(clean, alpha)
    return _Paired(complete, behaviour, clean[list(OUTCOMES)], perturbed[[*OUTCOMES, "axis", "severity"]])


def _unpaired(first: PolicyRows, second: PolicyRows, alpha: float) -> UnpairedComparison | None:
    """The comparison on separate trials, if start states of a side are not known and they have a common task."""
    if states_known(first.rows) and states_known(second.rows):
        return None
    return compare_unpaired((first.side, first.rows), (second.side, second.rows), alpha)


def _with_verdict(rows: pd.DataFrame) -> pd.DataFrame:
    return rows[rows["status"] != str(Status.ERROR)]


def perturbed_rows(rows: pd.DataFrame) -> pd.DataFrame:
    """The episodes under perturbations; controls, whose success is not what is wanted, are none."""
    combined = rows["axis"].astype(str).str.contains(AT, regex=False)
    return rows[(rows["severity"] > 0) & ~rows["axis"].isin(CONTROLS) & ~combined]


def _merged(first: pd.DataFrame, second: pd.DataFrame) -> pd.DataFrame:
    return first.merge(second, on="pair_id", suffixes=("", "_before"))


def _contrasted(
    compared: Sequence[_Paired], document: RunDocument, alpha: float, margin: float | None
) -> tuple[PolicyComparison, ...]:
    """Ask the questions: over all tasks, of simulators and tasks, and of each axis. Each adjusts its own tests."""
    clean, level = [one.clean for one in compared], alpha / 2
    several = [pairs if pairs["task"].nunique() > 1 else pairs[:0] for pairs in clean]
    overall = contrasts(clean, Question((all_pairs,), level, margin=margin, tests_all=True))
    parts = contrasts(several, Question((by_simulator, by_task), level, margin=margin))
    conditions: list[list[Contrast]] = [[] for _ in compared]
    for axis in dict.fromkeys(cell.axis for cell in document.plan):
        of_axis = [one.perturbed[one.perturbed["axis"] == axis] for one in compared]
        for shifts, found in zip(conditions, contrasts(of_axis, Question((by_condition,), level)), strict=True):
            shifts += found
    moved = adjusted([one.behaviour for one in compared])
    done = []
    for one, (whole,), found, shifts, behaviour in zip(compared, overall, parts, conditions, moved, strict=True):
        ordered = _in_order(found or [replace(whole, **stratum) for stratum, _ in by_task(one.clean)], document)
        done.append(
            one.complete(
                overall=whole,
                simulators=tuple(row for row in ordered if row.task is None),
                tasks=tuple(row for row in ordered if row.task is not None),
                conditions=tuple(shifts),
                behaviour=behaviour,
            )
        )
    return tuple(done)


def _in_order(rows: Sequence[Contrast], document: RunDocument) -> list[Contrast]:
    """Simulators and tasks in the order of the plan, tasks by simulator."""
    tasks = dict.fromkeys([*(cell.task for cell in document.plan), *(row.task for row in rows if row.task)])
    simulators = dict.fromkeys(task.partition("/")[0] for task in tasks)
    places = {name: place for names in (tasks, simulators) for place, name in enumerate(names)}
    return sorted(rows, key=lambda row: (places[row.simulator or ""], places[row.task] if row.task else -1))


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
