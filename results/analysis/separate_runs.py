"""Two runs whose trials are not paired, such as a simulated run and a table of trials of real robots.

Policies of the same name are compared on separate trials of the tasks that both runs have. With three policies or more
it is shown how well the first run predicts the second.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean, harmonic_mean
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.comparison import Difference, Run, RunComparison, Verdict
from robogauntlet.results.analysis.leaderboard import MOST_POLICIES
from robogauntlet.results.analysis.pairwise import PolicyRows
from robogauntlet.results.analysis.unpaired import (
    UnpairedComparison,
    UnpairedContrast,
    adjusted,
    compare_unpaired,
    states_known,
)
from robogauntlet.results.record import Status
from robogauntlet.results.run_document import RunError, RunStatus
from robogauntlet.results.statistics.rank_agreement import kendall, pearson, rank_violation, rate_agreement_bounds
from robogauntlet.results.statistics.rates import Estimate, wilson_intervals
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.text import counted, first_of

if TYPE_CHECKING:
    import pandas as pd

LEAST_POLICIES = 3
"""Runs are said to agree on the policies only with this number of them or more."""
DIGITS = 12
"""Decimal digits of a mean rate; a difference beyond them is one of rounding and counts as a tie."""


@dataclass(frozen=True, slots=True)
class PolicyRates:
    """The success rates of a policy in both runs, means over the tasks, with Wilson's intervals."""

    policy: str
    first: Estimate
    second: Estimate


@dataclass(frozen=True, slots=True)
class RunAgreement:
    """How well the rates of policies in the first run predict those in the second."""

    tasks: tuple[str, ...]
    """Those in which every policy has a verdict in both runs; a rate is the mean over them."""
    policies: tuple[PolicyRates, ...]
    pearson: float | None
    """Without an interval: that of resampled trials does not cover the true r. None if a run ties all policies."""
    tau: Estimate | None
    """Kendall's tau-b, see `rate_agreement_bounds`; None if a run ties all policies."""
    violation: Estimate
    """MMRV as a success rate in the second run."""


@dataclass(frozen=True, kw_only=True)
class SeparateRuns(RunComparison):
    """The comparison of two runs on separate trials; the confidence of its intervals is 1 - alpha."""

    separate: tuple[UnpairedComparison, ...]
    """Of each policy that both runs have, if they have a common task."""
    agreement: RunAgreement | None
    notes: tuple[str, ...]
    """What is not compared, and why."""


def are_separate(run: Run, baseline: Run) -> bool:
    """Whether trials of two runs, of which one came as outcomes only, are not paired."""
    if not (run.document.is_outcomes_only or baseline.document.is_outcomes_only):
        return False
    is_known = states_known(run.rows) and states_known(baseline.rows)
    return not is_known or set(run.rows["pair_id"]).isdisjoint(baseline.rows["pair_id"])


def compare_separate_runs(
    run: Run,
    baseline: Run,
    *,
    alpha: float,
    margin: float | None,
    only: Sequence[str] = (),
    tasks: Mapping[str, str] | None = None,
) -> SeparateRuns:
    """Compare the clean episodes of the policies that two runs have, for the arguments see `robogauntlet.compare`.

    Raises:
        RunError: `tasks` names a task that a run does not have, or makes one task of two.
    """
    first, second = _policies(run, only), _policies(_renamed(run, baseline, tasks or {}), only)
    both = [(first[name], second[name]) for name in first if name in second]
    compared = [compare_unpaired((one.side, one.rows), (other.side, other.rows), alpha) for one, other in both]
    found = adjusted([one for one in compared if one is not None])
    agreement = _agreement(found, alpha)
    left_out = [pair for pair, one in zip(both, compared, strict=True) if one is None]
    notes = [*_missing(run, baseline, first, second), *_not_compared(left_out)]
    if found and agreement is None:
        notes.append(f"how well {run.name} predicts {baseline.name} is not said: {_why_none(len(found))}")
    unfinished = [
        f"{side.name} is {side.document.status}"
        for side in (run, baseline)
        if side.document.status is not RunStatus.COMPLETE
    ]
    return SeparateRuns(
        run=run.name,
        baseline=baseline.name,
        alpha=alpha,
        margin=margin,
        verdict=Verdict.SEPARATE if found else Verdict.NOT_COMPARABLE,
        comparisons=(),
        differences={Difference.UNFINISHED: ", ".join(unfinished)} if unfinished else {},
        allowed=frozenset(),
        unpaired={one.first.policy: one.alone for one in found if any(one.alone)},
        errors={one.first.policy: one.errors for one in found if any(one.errors)},
        processors=(run.document.provenance.processor, baseline.document.provenance.processor),
        separate=found,
        agreement=agreement,
        notes=tuple(notes),
    )


def _policies(run: Run, only: Sequence[str]) -> dict[str, PolicyRows]:
    names = dict.fromkeys(cell.policy for cell in run.document.plan)
    return {name: PolicyRows.of_run(run, name) for name in names if not only or name in only}


def _renamed(run: Run, baseline: Run, tasks: Mapping[str, str]) -> Run:
    """The baseline with the names that its tasks have in the run."""
    for side, names in ((run, list(tasks)), (baseline, list(tasks.values()))):
        known = dict.fromkeys(cell.task for cell in side.document.plan)
        for name in names:
            if name not in known:
                raise RunError(f"{side.name}: the run has no task '{name}'{_meant(name, known)}")
    own_names = {theirs: own for own, theirs in tasks.items()}
    given = baseline.rows["task"].astype(str)
    renamed = given.map(lambda task: own_names.get(task, task))
    if renamed.nunique() < given.nunique() or len(own_names) < len(tasks):
        raise RunError(f"{baseline.name}: expected another task for each task of {run.name}, got one for two")
    return replace(baseline, rows=baseline.rows.assign(task=renamed))


def _missing(
    run: Run, baseline: Run, first: Mapping[str, PolicyRows], second: Mapping[str, PolicyRows]
) -> Iterator[str]:
    """The policies that only one of the runs has."""
    if alone := [policy for policy in first if policy not in second]:
        yield f"policies that only {run.name} has: {first_of(alone)}"
    if alone := [policy for policy in second if policy not in first]:
        yield f"policies that only {baseline.name} has: {first_of(alone)}{_meant(alone[0], first)}"


def _not_compared(pairs: Sequence[tuple[PolicyRows, PolicyRows]]) -> Iterator[str]:
    """The policies of both runs that have no task in common, and why."""
    without: dict[str, list[str]] = {}
    for sides in pairs:
        tasks = [_tasks(side.rows) for side in sides]
        if empty := [side for side, own in zip(sides, tasks, strict=True) if not own]:
            rows = empty[0].rows
            errors = f", {counted(len(rows), 'error')}" if len(rows) else ""
            reason = f"expected a clean trial with a verdict in {empty[0].side.run}, got none{errors}"
        else:
            reason = (
                f"expected a task that both runs have, got {first_of(tasks[0])} and {first_of(tasks[1])}"
                f"{_meant(tasks[1][0], tasks[0])}; --task TASK=OTHER says which are the same"
            )
        without.setdefault(reason, []).append(sides[0].side.policy)
    yield from (f"{first_of(policies)}: {reason}" for reason, policies in without.items())


def _meant(name: str, known: Iterable[str]) -> str:
    """Which known name is meant, first of all one that differs in case, or in the simulator, only."""
    last = name.rpartition("/")[2].casefold()
    return did_you_mean(name, known, meant=[one for one in known if one.rpartition("/")[2].casefold() == last])


def _tasks(rows: pd.DataFrame) -> list[str]:
    """Tasks with a verdict."""
    return list(dict.fromkeys(rows["task"][rows["status"] != str(Status.ERROR)].astype(str)))


def _why_none(policies: int) -> str:
    """Why so many policies of both runs have no agreement."""
    if LEAST_POLICIES <= policies <= MOST_POLICIES:
        return f"expected a task that all {policies} policies have in both runs, got none"
    return f"expected {LEAST_POLICIES} to {MOST_POLICIES} policies that both runs have, got {policies}"


def _agreement(found: Sequence[UnpairedComparison], alpha: float) -> RunAgreement | None:
    """The agreement of both runs; None with too few policies, too many, or without a task that all of them have."""
    lines = [{line.task or "": line for line in one.tasks} for one in found]
    tasks = [task for task in lines[0] if all(task in own for own in lines)] if lines else []
    if not LEAST_POLICIES <= len(found) <= MOST_POLICIES or not tasks:
        return None
    first, second = ([_mean([own[task] for task in tasks], side) for own in lines] for side in ("first", "second"))
    one, other = ([mean.rate for mean in side] for side in (first, second))
    order = kendall(one, other)
    predicted, real = ([(mean.successes, mean.trials) for mean in side] for side in (first, second))
    tau, violation = rate_agreement_bounds(real, predicted, 1 - alpha)
    return RunAgreement(
        tasks=tuple(tasks),
        policies=tuple(
            PolicyRates(policy.first.policy, *(mean.estimate(alpha) for mean in means))
            for policy, *means in zip(found, first, second, strict=True)
        ),
        pearson=pearson(one, other),
        tau=None if order is None else Estimate(order[0], tau),
        violation=Estimate(rank_violation(other, one), violation),
    )


@dataclass(frozen=True, slots=True)
class _Mean:
    """The mean success rate over tasks."""

    rate: float
    trials: float
    """The number of trials, as many in each task, that is as informative."""

    @property
    def successes(self) -> float:
        """Of so many trials."""
        return self.rate * self.trials

    def estimate(self, alpha: float) -> Estimate:
        return Estimate(self.rate, wilson_intervals([self.successes], [self.trials], 1 - alpha)[0])


def _mean(lines: Sequence[UnpairedContrast], side: str) -> _Mean:
    counts = [(getattr(line.counts, side), getattr(line.counts, f"{side}_trials")) for line in lines]
    rate = round(fmean(won / trials for won, trials in counts), DIGITS)
    return _Mean(rate, len(counts) * harmonic_mean([trials for _, trials in counts]))
