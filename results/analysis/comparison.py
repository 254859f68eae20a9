"""Comparison of a run with a baseline run of the same suite.

Episodes are paired by `pair_id` (task, condition, seed and protocol) and by the policy's name. McNemar's exact test is
made for each task of each policy and for each policy over all its tasks; the p-values of one direction are adjusted
together by Holm's method. A run without a change is therefore called worse with a probability of at most alpha,
whatever its number of tasks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import islice
from typing import TYPE_CHECKING

from robogauntlet.results.analysis.paired_behaviour import BehaviourComparison, adjusted, compare_behaviour
from robogauntlet.results.record import BEHAVIOUR, Status
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
from robogauntlet.suites.schema import Suite
from robogauntlet.support.text import counted

if TYPE_CHECKING:
    import pandas as pd

OWN = "the run's own environment"
COLUMNS = (
    *("pair_id", "policy", "policy_digest", "simulator", "task", "seed", "status", "state_hash", "actions_hash"),
    *BEHAVIOUR,
)
"""Fields of the record that a comparison needs."""
SETTINGS = ("protocol", "success_rule", "horizon", "replan_every", "cameras", "image_size", "render_profile")
"""Properties of a suite that all its episodes have: of runs that share no episode, those that differ are named."""


class Verdict(StrEnum):
    """The result of a comparison."""

    REGRESSED = "regressed"
    IMPROVED = "improved"
    NO_EVIDENCE = "no evidence"
    """Neither, which does not mean no difference, see `PolicyComparison.no_worse`."""
    NOT_COMPARABLE = "not comparable"


class Difference(StrEnum):
    """A difference of two runs besides the policies."""

    SUITE = "suite"
    SIMULATOR = "simulator"
    RENDERER = "renderer"
    UNFINISHED = "unfinished"
    """One of them is not complete."""
    WORLD = "world"
    """Episodes of the same seed start from different physical states."""


@dataclass(frozen=True)
class Line:
    """A task of a policy, or all its tasks, in the run and in the baseline."""

    task: str | None
    """None for all tasks."""
    pairs: Pairs
    """First side: the run; second: the baseline."""
    difference: Estimate | None
    """Rate of the run minus rate of the baseline, with a confidence of 1 - 2 alpha."""
    detectable: float | None
    """The smallest drop that this number of pairs shows in four of five cases, see `pairs.detectable_drop`."""
    p_worse: float = 1.0
    """Adjusted over all lines of the comparison."""
    p_better: float = 1.0
    """The same in the other direction."""


@dataclass(frozen=True)
class PolicyComparison:
    """A policy in the run and in the baseline."""

    policy: str
    changed: bool
    """Whether its content differs from that in the baseline."""
    differing: int
    """Pairs whose actions differ; if the policy has not changed, the cause is the program or the simulator."""
    tasks: tuple[Line, ...]
    whole: Line
    no_worse: bool
    """Whether it is shown, over all tasks, to be worse than the baseline by less than the margin."""
    behaviour: BehaviourComparison | None = None
    """How it moves and fails in the run, against the baseline; None if that was not measured in both."""

    @property
    def lines(self) -> tuple[Line, ...]:
        """The tested lines: the tasks, and all tasks if there are several."""
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
    """The comparison of a run with a baseline."""

    run: str
    baseline: str
    alpha: float
    margin: float
    verdict: Verdict
    policies: tuple[PolicyComparison, ...]
    differences: Mapping[Difference, str]
    """Other differences in words, including those that were allowed."""
    allowed: Set[Difference]
    unpaired: Mapping[str, tuple[int, int]]
    """Policy to its episodes in the run alone and in the baseline alone; errors are in neither."""
    errors: Mapping[str, tuple[int, int]]
    """Policy to its errors in the run and in the baseline."""
    processors: tuple[str, str] = ("", "")
    """Processors of the run and of the baseline."""

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
    """Compare a run with a baseline, see `robogauntlet.compare`."""
    rows = [side.rows[side.rows["policy"].isin(only)] if only else side.rows for side in (run, baseline)]
    sides = [of_side[of_side["status"] != str(Status.ERROR)] for of_side in rows]
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
        errors=_errors(rows),
        processors=(run.document.provenance.processor, baseline.document.provenance.processor),
    )


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
        behaviour=compare_behaviour(pairs, alpha, (name,)),
    )


def _line(task: str | None, pairs: Pairs, alpha: float) -> Line:
    return Line(task, pairs, paired_difference(pairs, 1 - 2 * alpha), detectable_drop(pairs, alpha))


def family_p_values(family: Sequence[Pairs], alpha: float) -> list[tuple[float, float]]:
    """Adjusted p-values (worse, better) for each of a family of comparisons of a run with its baseline.

    Comparisons that cannot reach alpha do not belong to the family and have 1, see `pairs.can_reject`.
    """
    tested = [place for place, pairs in enumerate(family) if can_reject(pairs, alpha)]
    chosen = [family[place] for place in tested]
    worse = holm([mcnemar_worse(pairs) for pairs in chosen])
    better = holm([mcnemar_worse(Pairs(p.both, p.second_only, p.first_only, p.neither)) for p in chosen])
    found = dict(zip(tested, zip(worse, better, strict=True), strict=True))
    return [found.get(place, (1.0, 1.0)) for place in range(len(family))]


def _adjusted(policies: Sequence[PolicyComparison], alpha: float) -> list[PolicyComparison]:
    """Add p-values: all tasks of all policies, and each policy over several tasks, are one family."""
    p_values = iter(family_p_values([line.pairs for one in policies for line in one.lines], alpha))
    moved = adjusted([one.behaviour for one in policies])
    found_policies = []
    for one, behaviour in zip(policies, moved, strict=True):
        found = zip(one.lines, islice(p_values, len(one.lines)), strict=True)
        lines = tuple(replace(line, p_worse=worse, p_better=better) for line, (worse, better) in found)
        whole = replace(lines[-1], task=None)
        found_policies.append(replace(one, tasks=lines[: len(one.tasks)], whole=whole, behaviour=behaviour))
    return found_policies


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
            done = f"{len(side.rows):,} of {counted(side.document.planned, 'episode')} done"
            found[Difference.UNFINISHED] = f"{side.name} is {side.document.status}, {done}"
    if now.suite.name != before.suite.name:
        found[Difference.SUITE] = f"suite '{now.suite.name}', the baseline has '{before.suite.name}'"
    elif (lines := _plan(now)) != (others := _plan(before)):
        new, gone = len(lines - others), len(others - lines)
        text = (
            f"the suite plans other episodes: {counted(new, 'new cell')}, {gone:,} gone or with another number of seeds"
        )
        found[Difference.SUITE] = text
    elif pairs.empty and (other := _other_settings(now.suite, before.suite)):
        found[Difference.SUITE] = f"the suite has {other}"
    return found | setting_differences(now, before, pairs)


def setting_differences(now: RunDocument, before: RunDocument, pairs: pd.DataFrame) -> dict[Difference, str]:
    """Return what differs in simulators, renderers and initial states, in words.

    `pairs` has the initial states of both sides in `state_hash` and `state_hash_before`.
    """
    found: dict[Difference, str] = {}
    one_side = {cell.simulator for cell in now.plan} ^ {cell.simulator for cell in before.plan}
    if versions := _versions(now.provenance, before.provenance, one_side):
        found[Difference.SIMULATOR] = ", ".join(versions)
    devices = [
        f"{name} rendered on {before.render_devices[name]}, now on {device}"
        for name, device in now.render_devices.items()
        if before.render_devices.get(name, device) != device
    ]
    if devices:
        found[Difference.RENDERER] = "; ".join(devices)
    if moved := int((pairs["state_hash"] != pairs["state_hash_before"]).sum()):
        found[Difference.WORLD] = f"another physical state at the start of {moved:,} of {counted(len(pairs), 'pair')}"
    return found


def _other_settings(now: Suite, before: Suite) -> str:
    values = ((name, str(getattr(now, name)), str(getattr(before, name))) for name in SETTINGS)
    return ", ".join(f"{name} {new}, the baseline {old}" for name, new, old in values if new != old)


def _plan(document: RunDocument) -> set[tuple[str, str, str, int, int]]:
    """Cells of the plan without digests, and without the number of seeds in adaptive runs, which changes."""

    def seeds(cell: PlannedCell) -> int:
        return 0 if document.suite.adaptive else cell.planned

    return {(cell.policy, cell.task, cell.axis, cell.severity, seeds(cell)) for cell in document.plan}


def _versions(now: Provenance, before: Provenance, one_side: Set[str]) -> list[str]:
    """Packages of simulators that have different versions in both runs, and simulators in other environments.

    `one_side` are the simulators that only one of the runs has.
    """
    then = before.versions
    changed = [
        f"{name} {then[name]}, now {version}"
        for name, version in sorted(now.versions.items())
        if name not in EVERYWHERE and then.get(name, version) != version
    ]
    was, new = ({name: f"environment {one.hash}" for name, one in run.environments.items()} for run in (before, now))
    moved = [
        f"{name} in {was.get(name, OWN)}, now in {new.get(name, OWN)}"
        for name in sorted((was.keys() | new.keys()) - one_side)
        if was.get(name) != new.get(name)
    ]
    return changed + moved


def _unpaired(sides: Sequence[pd.DataFrame], pairs: pd.DataFrame) -> dict[str, tuple[int, int]]:
    counts = [side["policy"].value_counts() for side in sides]
    paired = pairs["policy"].value_counts()
    names = dict.fromkeys(str(name) for side in sides for name in side["policy"].unique())
    found = {name: tuple(int(c.get(name, 0) - paired.get(name, 0)) for c in counts) for name in names}
    return {name: (alone[0], alone[1]) for name, alone in found.items() if any(alone)}


def _errors(sides: Sequence[pd.DataFrame]) -> dict[str, tuple[int, int]]:
    now, before = (side["policy"][side["status"] == str(Status.ERROR)].value_counts() for side in sides)
    return {
        str(name): (int(now.get(name, 0)), int(before.get(name, 0)))
        for name in dict.fromkeys([*now.index, *before.index])
    }
