"""Two runs of one suite against each other: what became worse, what better, and whether that can be said at all.

Episodes are paired by identity (task, condition, seed and protocol: `pair_id`), policy by policy of the same name, so
that what differs is the policy or the program and nothing else. Each task of each policy is tested by McNemar's exact
test, and so is a policy over all its tasks; the p-values of one direction are adjusted together by Holm's method. So a
run without any change is called worse at most once in 1 / alpha times, however many tasks it has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import islice
from typing import TYPE_CHECKING

from robogauntlet.results.record import Status
from robogauntlet.results.run_document import EVERYWHERE, PlannedCell, Provenance, RunDocument, RunStatus
from robogauntlet.results.statistics.multiplicity import ALPHA, holm
from robogauntlet.results.statistics.pairs import (
    MARGIN,
    Pairs,
    can_reject,
    detectable_drop,
    is_no_worse,
    mcnemar_worse,
    paired_difference,
    pooled,
)
from robogauntlet.results.statistics.rates import Estimate

if TYPE_CHECKING:
    import pandas as pd

OWN = "the run's own environment"
COLUMNS = ("pair_id", "policy", "policy_digest", "simulator", "task", "status", "state_hash", "actions_hash")
"""Fields of the record that a comparison is made from."""


class Verdict(StrEnum):
    """What a comparison comes to."""

    REGRESSED = "regressed"
    IMPROVED = "improved"
    NO_EVIDENCE = "no evidence"
    """Neither; which is not the same as no difference, see `PolicyComparison.no_worse`."""
    NOT_COMPARABLE = "not comparable"


class Difference(StrEnum):
    """In what two runs can differ besides the policies."""

    SUITE = "suite"
    SIMULATOR = "simulator"
    RENDERER = "renderer"
    UNFINISHED = "unfinished"
    """One of them has not come to its end."""
    WORLD = "world"
    """Episodes of the same seed start from other physical states."""


@dataclass(frozen=True)
class Line:
    """A task of a policy, or all its tasks together, now and in the baseline."""

    task: str | None
    """None for all together."""
    pairs: Pairs
    """First side: the run; second: the baseline."""
    difference: Estimate | None
    """Rate of the run minus rate of the baseline, with a confidence of 1 - 2 alpha."""
    detectable: float | None
    """The smallest drop that this number of pairs would show in four of five cases, see `pairs.detectable_drop`."""
    p_worse: float = 1.0
    """Adjusted over all lines of the comparison."""
    p_better: float = 1.0
    """The same, of the other direction."""


@dataclass(frozen=True)
class PolicyComparison:
    """A policy, now and in the baseline."""

    policy: str
    changed: bool
    """Whether its content is another than in the baseline."""
    differing: int
    """Pairs whose actions differ; if the policy has not changed, that is the program's or the simulator's doing."""
    tasks: tuple[Line, ...]
    whole: Line
    no_worse: bool
    """Whether it is shown to be no worse than the baseline by more than the margin, over all tasks."""

    @property
    def lines(self) -> tuple[Line, ...]:
        """What is tested: the tasks, and all together if there are several."""
        return (*self.tasks, self.whole) if len(self.tasks) > 1 else self.tasks


@dataclass(frozen=True)
class Run:
    """A run's document and rows."""

    name: str
    document: RunDocument
    rows: pd.DataFrame
    """Columns `COLUMNS`."""


@dataclass(frozen=True)
class Comparison:
    """What two runs say of each other."""

    run: str
    baseline: str
    alpha: float
    margin: float
    verdict: Verdict
    policies: tuple[PolicyComparison, ...]
    differences: Mapping[Difference, str]
    """What else differs, in words, whether it was allowed or not."""
    allowed: Set[Difference]
    unpaired: Mapping[str, tuple[int, int]]
    """Policy to its episodes in the run alone and in the baseline alone; errors are in neither."""
    errors: Mapping[str, tuple[int, int]]
    """Policy to its errors in the run and in the baseline."""
    processors: tuple[str, str] = ("", "")
    """On what the run and the baseline were played."""

    @property
    def pairs(self) -> int:
        """Episodes compared."""
        return sum(one.whole.pairs.trials for one in self.policies)


def compare_runs(
    run: Run,
    baseline: Run,
    *,
    alpha: float = ALPHA,
    margin: float = MARGIN,
    only: Sequence[str] = (),
    allowed: Set[Difference] = frozenset(),
) -> Comparison:
    """Compare a run with a baseline.

    Args:
        run: The newer one.
        baseline: What it is compared with.
        alpha: Chance at most of a false "regressed", and of a false "improved".
        margin: A rate that is lower by less than this counts as no worse.
        only: Names of policies; empty for all that both have.
        allowed: Differences that do not forbid the comparison.
    """
    sides = [_judged(one, only) for one in (run, baseline)]
    pairs = sides[0].merge(sides[1], on=["policy", "pair_id"], suffixes=("", "_before"))
    differences = _differences(run, baseline, pairs)
    names = list(dict.fromkeys(pairs["policy"]))
    policies = _adjusted([_policy(str(name), pairs[pairs["policy"] == name], alpha, margin) for name in names], alpha)
    forbidden = [one for one in differences if one not in allowed]
    return Comparison(
        run=run.name,
        baseline=baseline.name,
        alpha=alpha,
        margin=margin,
        verdict=Verdict.NOT_COMPARABLE if forbidden or not policies else _verdict(policies, alpha),
        policies=tuple(policies),
        differences=differences,
        allowed=allowed,
        unpaired=_unpaired(sides, pairs),
        errors=_errors(run, baseline, only),
        processors=(run.document.provenance.processor, baseline.document.provenance.processor),
    )


def _judged(run: Run, only: Sequence[str]) -> pd.DataFrame:
    """Rows with a verdict, of these policies."""
    rows = run.rows[run.rows["status"] != str(Status.ERROR)]
    return rows[rows["policy"].isin(only)] if only else rows


def _policy(name: str, pairs: pd.DataFrame, alpha: float, margin: float) -> PolicyComparison:
    tasks = []
    for task, own in pairs.groupby("task", sort=False, observed=True):
        now, before = (own[column] == str(Status.SUCCESS) for column in ("status", "status_before"))
        tasks.append(_line(str(task), Pairs.from_outcomes(now.to_numpy(float), before.to_numpy(float)), alpha))
    together = pooled(line.pairs for line in tasks)
    return PolicyComparison(
        policy=name,
        changed=bool((pairs["policy_digest"] != pairs["policy_digest_before"]).any()),
        differing=int((pairs["actions_hash"] != pairs["actions_hash_before"]).sum()),
        tasks=tuple(tasks),
        whole=_line(None, together, alpha),
        no_worse=is_no_worse(together, margin, 1 - 2 * alpha),
    )


def _line(task: str | None, pairs: Pairs, alpha: float) -> Line:
    return Line(task, pairs, paired_difference(pairs, 1 - 2 * alpha), detectable_drop(pairs, alpha))


def family_p_values(family: Sequence[Pairs], alpha: float) -> list[tuple[float, float]]:
    """Adjusted p-values of worse and of better, for each of a family of comparisons of a run with its baseline.

    What could not come to alpha however its pairs fell is not of the family, and has 1: see `pairs.can_reject`.
    """
    tested = [place for place, pairs in enumerate(family) if can_reject(pairs, alpha)]
    worse = holm([mcnemar_worse(family[place]) for place in tested])
    better = holm([mcnemar_worse(_turned(family[place])) for place in tested])
    found = dict(zip(tested, zip(worse, better, strict=True), strict=True))
    return [found.get(place, (1.0, 1.0)) for place in range(len(family))]


def _adjusted(policies: Sequence[PolicyComparison], alpha: float) -> list[PolicyComparison]:
    """With p-values: all tasks of all policies, and each policy over several tasks, are one family."""
    p_values = iter(family_p_values([line.pairs for one in policies for line in one.lines], alpha))

    adjusted = []
    for one in policies:
        found = zip(one.lines, islice(p_values, len(one.lines)), strict=True)
        lines = tuple(replace(line, p_worse=worse, p_better=better) for line, (worse, better) in found)
        adjusted.append(replace(one, tasks=lines[: len(one.tasks)], whole=replace(lines[-1], task=None)))
    return adjusted


def _turned(pairs: Pairs) -> Pairs:
    return Pairs(pairs.both, pairs.second_only, pairs.first_only, pairs.neither)


def _verdict(policies: Sequence[PolicyComparison], alpha: float) -> Verdict:
    lines = [line for one in policies for line in one.lines]
    if any(line.p_worse <= alpha for line in lines):
        return Verdict.REGRESSED
    return Verdict.IMPROVED if any(line.p_better <= alpha for line in lines) else Verdict.NO_EVIDENCE


def _differences(run: Run, baseline: Run, pairs: pd.DataFrame) -> dict[Difference, str]:
    found: dict[Difference, str] = {}
    now, before = run.document, baseline.document
    for side in (run, baseline):
        if side.document.status is not RunStatus.COMPLETE:
            played = f"{len(side.rows):,} of {side.document.planned:,} episodes are played"
            found[Difference.UNFINISHED] = f"{side.name} is {side.document.status}, {played}"
    if now.suite.name != before.suite.name:
        found[Difference.SUITE] = f"suite '{now.suite.name}', the baseline is of '{before.suite.name}'"
    elif (lines := _plan(now)) != (others := _plan(before)):
        found[Difference.SUITE] = f"the suite plans other episodes: {len(lines - others)} cells are new, "
        found[Difference.SUITE] += f"{len(others - lines)} are gone or have another number of seeds"
    if versions := _versions(now.provenance, before.provenance):
        found[Difference.SIMULATOR] = ", ".join(versions)
    devices = [
        f"{name} drew on {before.render_devices[name]}, now on {device}"
        for name, device in now.render_devices.items()
        if before.render_devices.get(name, device) != device
    ]
    if devices:
        found[Difference.RENDERER] = "; ".join(devices)
    if moved := int((pairs["state_hash"] != pairs["state_hash_before"]).sum()):
        found[Difference.WORLD] = f"{moved} of {len(pairs)} pairs start from another physical state"
    return found


def _plan(document: RunDocument) -> set[tuple[str, str, str, int, int]]:
    """Cells without what a policy is made of; adaptive runs plan as they go, so their numbers do not count."""

    def seeds(cell: PlannedCell) -> int:
        return 0 if document.suite.adaptive else cell.planned

    return {(cell.policy, cell.task, cell.axis, cell.severity, seeds(cell)) for cell in document.plan}


def _versions(now: Provenance, before: Provenance) -> list[str]:
    """The simulators' packages that both runs name in different versions, and simulators that have moved."""
    then = before.versions
    changed = [
        f"{name} {then[name]}, now {version}"
        for name, version in sorted(now.versions.items())
        if name not in EVERYWHERE and then.get(name, version) != version
    ]
    homes = [{name: f"environment {one.hash}" for name, one in made.environments.items()} for made in (before, now)]
    moved = [
        f"{name} in {homes[0].get(name, OWN)}, now in {homes[1].get(name, OWN)}"
        for name in sorted(homes[0].keys() | homes[1].keys())
        if homes[0].get(name) != homes[1].get(name)
    ]
    return changed + moved


def _unpaired(sides: Sequence[pd.DataFrame], pairs: pd.DataFrame) -> dict[str, tuple[int, int]]:
    counts = [side["policy"].value_counts() for side in sides]
    paired = pairs["policy"].value_counts()
    names = dict.fromkeys(str(name) for side in sides for name in side["policy"].unique())
    found = {name: tuple(int(c.get(name, 0) - paired.get(name, 0)) for c in counts) for name in names}
    return {name: (alone[0], alone[1]) for name, alone in found.items() if any(alone)}


def _errors(run: Run, baseline: Run, only: Sequence[str]) -> dict[str, tuple[int, int]]:
    counts = []
    for side in (run, baseline):
        wrong = side.rows[side.rows["status"] == str(Status.ERROR)]
        counts.append((wrong[wrong["policy"].isin(only)] if only else wrong)["policy"].value_counts())
    names = dict.fromkeys(str(name) for one in counts for name in one.index)
    return {name: (int(counts[0].get(name, 0)), int(counts[1].get(name, 0))) for name in names}
