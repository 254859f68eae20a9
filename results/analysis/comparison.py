"""Comparison of policies, and of a run with a baseline run of the same suite.

Episodes are paired by `pair_id` (task, condition, seed and protocol), those of two runs also by the policy's name. For
two runs, McNemar's exact test is made for each task of each policy and for each policy over all its tasks; the
p-values of one direction are adjusted together by Holm's method. A run without a change is therefore called worse with
a probability of at most alpha, whatever its number of tasks. Policies are compared in `pairwise`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar, Literal

from robogauntlet.results.analysis.contrasts import OUTCOMES, Contrast, Question, all_tasks, by_task, contrasts
from robogauntlet.results.analysis.paired_behaviour import (
    BehaviourComparison,
    OutcomeChange,
    adjusted,
    compare_behaviour,
)
from robogauntlet.results.record import BEHAVIOUR, Status
from robogauntlet.results.run_document import EVERYWHERE, PlannedCell, Provenance, RunDocument, RunStatus
from robogauntlet.results.statistics.multiplicity import ALPHA
from robogauntlet.results.statistics.pairs import MARGIN, mcnemar_better, mcnemar_worse
from robogauntlet.suites.schema import Suite
from robogauntlet.support.text import counted

if TYPE_CHECKING:
    import pandas as pd

OWN = "the run's own environment"
COLUMNS = (
    *("pair_id", "policy", "policy_digest", "simulator", "task", "seed", "status", "state_hash", "actions_hash"),
    *BEHAVIOUR,
)
"""Fields of the record that a comparison of runs needs."""
SETTINGS = ("protocol", "success_rule", "timing", "horizon", "replan_every", "cameras", "image_size", "render_profile")
"""Properties of a suite that all its episodes have: of runs that share no episode, those that differ are named."""


class Verdict(StrEnum):
    """The result of a comparison of runs."""

    REGRESSED = "regressed"
    IMPROVED = "improved"
    NO_EVIDENCE = "no evidence"
    """Neither, which does not mean no difference, see `Contrast.no_worse`."""
    NOT_COMPARABLE = "not comparable"
    SEPARATE = "separate trials"
    """Trials of the runs are not paired, so that policies are compared and the run is not judged."""


class Difference(StrEnum):
    """A difference of two runs besides the policies."""

    SUITE = "suite"
    SIMULATOR = "simulator"
    RENDERER = "renderer"
    UNFINISHED = "unfinished"
    """One of them is not complete."""
    WORLD = "world"
    """Episodes of the same seed start from different physical states."""


@dataclass(frozen=True, slots=True)
class Side:
    """A policy of a run."""

    policy: str
    run: str
    """Name of the run."""
    policy_digest: str


@dataclass(frozen=True)
class PolicyComparison:
    """A policy against another on the episodes that both played."""

    first: Side
    second: Side
    overall: Contrast
    simulators: tuple[Contrast, ...]
    """Simulators with several tasks, if policies are compared and there are several simulators."""
    tasks: tuple[Contrast, ...]
    identical: int
    """Pairs of `overall` in which both policies executed the same actions."""
    errors: tuple[int, int]
    """Episodes of each that ended in an error; they are left out. Clean ones, if policies are compared."""
    unpaired: tuple[int, int]
    """Episodes of each with a verdict, of which the other has no verdict; likewise."""
    differences: Mapping[Difference, str] = field(default_factory=dict)
    """What else differs between the runs of two policies, in words."""
    conditions: tuple[Contrast, ...] = ()
    """Perturbed conditions, controls excepted, if policies are compared; in none of the contrasts above."""
    perturbed_left_out: tuple[int, int] = (0, 0)
    """Perturbed episodes of each that are in no pair."""
    behaviour: BehaviourComparison | None = None
    """How they move and fail in the pairs of `overall`; None if that was not measured for both."""
    perturbed_changes: tuple[OutcomeChange, ...] = ()
    """Outcomes of the perturbed pairs in which a side failed."""

    @property
    def parts(self) -> tuple[Contrast, ...]:
        """The simulators and tasks; a single task is `overall`."""
        return (*self.simulators, *self.tasks) if len(self.tasks) > 1 else ()

    @property
    def contrasts(self) -> tuple[Contrast, ...]:
        """The tasks, and all of them together if there are several."""
        return (*self.tasks, self.overall) if len(self.tasks) > 1 else self.tasks

    @property
    def is_same_policy(self) -> bool:
        """Whether both sides have the same content."""
        return self.first.policy_digest == self.second.policy_digest

    @property
    def differing(self) -> int:
        """Pairs whose actions differ; of the same policy, the cause is the program or the simulator."""
        return self.overall.pairs.trials - self.identical


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What `compare` found."""

    kind: ClassVar[Literal["runs", "policies"]] = "policies"
    """What was compared: a run with a baseline run, policy by policy; or policies with each other."""
    alpha: float
    """Significance level of the adjusted p-values."""
    margin: float | None
    """Largest decrease of a rate that counts as no worse; None if that is not tested."""
    baseline: str | None
    """The policy or the run with which the others are compared; None if any two policies are compared."""
    comparisons: tuple[PolicyComparison, ...]


@dataclass(frozen=True)
class Run:
    """A run's document and rows."""

    name: str
    document: RunDocument
    rows: pd.DataFrame
    """Columns `COLUMNS`."""


@dataclass(frozen=True, kw_only=True)
class RunComparison(Comparison):
    """The comparison of a run with a baseline; the confidence of its intervals is 1 - 2 alpha."""

    kind = "runs"
    baseline: str
    run: str
    verdict: Verdict
    differences: Mapping[Difference, str]
    """Other differences in words, including those that were allowed."""
    allowed: Set[Difference]
    unpaired: Mapping[str, tuple[int, int]]
    """Policy to its episodes in the run alone and in the baseline alone; errors are in neither."""
    errors: Mapping[str, tuple[int, int]]
    """Policy to its errors in the run and in the baseline."""
    processors: tuple[str, str] = ("", "")
    """Processors of the run and of the baseline."""


def compare_runs(
    run: Run,
    baseline: Run,
    *,
    alpha: float = ALPHA,
    margin: float = MARGIN,
    only: Sequence[str] = (),
    allowed: Set[Difference] = frozenset(),
) -> RunComparison:
    """Compare a run with a baseline, see `robogauntlet.compare`."""
    rows = [side.rows[side.rows["policy"].isin(only)] if only else side.rows for side in (run, baseline)]
    sides = [of_side[of_side["status"] != str(Status.ERROR)] for of_side in rows]
    pairs = sides[0].merge(sides[1], on=["policy", "pair_id"], suffixes=("", "_before"))
    differences = _differences(run, baseline, pairs)
    unpaired, errors = _unpaired(sides, pairs), _errors(rows)
    question = regression_question(alpha, margin)
    found = contrasts(
        [own for _, own in pairs[["policy", *OUTCOMES]].groupby("policy", sort=False, observed=True)], question
    )
    comparisons = []
    for (name, own), strata in zip(pairs.groupby("policy", sort=False, observed=True), found, strict=True):
        name, digests = str(name), [str(own[f"policy_digest{side}"].iloc[0]) for side in ("", "_before")]
        comparisons.append(
            PolicyComparison(
                first=Side(name, run.name, digests[0]),
                second=Side(name, baseline.name, digests[1]),
                overall=replace(strata[-1], simulator=None, task=None),
                simulators=(),
                tasks=tuple(one for one in strata if one.task is not None),
                identical=same_actions(own),
                errors=errors.get(name, (0, 0)),
                unpaired=unpaired.get(name, (0, 0)),
                behaviour=compare_behaviour(own, alpha),
            )
        )
    moved = adjusted([one.behaviour for one in comparisons])
    forbidden = [one for one in differences if one not in allowed]
    return RunComparison(
        run=run.name,
        baseline=baseline.name,
        alpha=alpha,
        margin=margin,
        verdict=Verdict.NOT_COMPARABLE if forbidden or not comparisons else _verdict(found, alpha),
        comparisons=tuple(replace(one, behaviour=own) for one, own in zip(comparisons, moved, strict=True)),
        differences=differences,
        allowed=allowed,
        unpaired=unpaired,
        errors=errors,
        processors=(run.document.provenance.processor, baseline.document.provenance.processor),
    )


def regression_question(alpha: float, margin: float = MARGIN) -> Question:
    """Whether a run is worse than its baseline, or better, in a task or over all tasks of a policy."""
    return Question((by_task, all_tasks), alpha, mcnemar_worse, mcnemar_better, margin=margin)


def _verdict(found: Sequence[Sequence[Contrast]], alpha: float) -> Verdict:
    every = [one for own in found for one in own]
    if any(one.adjusted <= alpha for one in every):
        return Verdict.REGRESSED
    is_better = any(one.opposite is not None and one.opposite <= alpha for one in every)
    return Verdict.IMPROVED if is_better else Verdict.NO_EVIDENCE


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


def same_actions(pairs: pd.DataFrame) -> int:
    """Pairs in which both sides executed the same actions; what rows of others do not say is not the same."""
    return int(((pairs["actions_hash"] == pairs["actions_hash_before"]) & (pairs["actions_hash"] != "")).sum())


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
