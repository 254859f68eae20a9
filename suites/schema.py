"""The suite: what a suite file says, validated. Which names exist is told by a `KnownNames`, so nothing is imported."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

from suites.environments import EnvironmentEntry
from suites.known import KnownNames, KnownTask
from suites.placement import Inference, Resources
from suites.plugins import nearest
from suites.shorthand import policy_entry
from suites.vocabulary import CAMERAS, CLEAN, CONTROLS, Cell, Condition, Protocol, RenderProfile, View, content_hash

MOST_SEVERE = 5
Count = Annotated[int, Field(strict=True, ge=1)]
Name = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=80)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PolicyEntry(_Model):
    """A policy of the suite: a kind, the options it is built with, and the name under which it is reported."""

    name: Name
    kind: str
    options: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _shorthand(cls, value: Any) -> Any:
        if isinstance(value, str):
            return policy_entry(value)
        if isinstance(value, dict) and isinstance(value.get("kind"), str):
            return {"name": value["kind"], **value}
        return value


class ConditionEntry(_Model):
    """A perturbation axis with the severities to run, `clean`, or a control."""

    axis: str
    severities: tuple[Annotated[int, Field(strict=True, ge=0, le=5)], ...] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _shorthand(cls, value: Any) -> Any:
        # A name alone is clean or a control; severity 0 of anything else is refused when names are checked.
        return {"axis": value, "severities": [int(value in CONTROLS)]} if isinstance(value, str) else value

    def conditions(self) -> list[Condition]:
        """One condition per severity."""
        return [Condition(self.axis, severity) for severity in self.severities]


class Seeds(_Model):
    """A block of consecutive seeds."""

    start: Annotated[int, Field(strict=True, ge=0, lt=2**31)] = 0
    count: Annotated[int, Field(strict=True, ge=1, le=10_000_000)]

    def __iter__(self) -> Any:
        return iter(range(self.start, self.start + self.count))


class MergingEntry(_Model):
    """Which of the suite's policies stand for what in a comparison of experts with the model merged from them."""

    expert: Name
    """Acts as each task's own expert."""
    oracle_routed: Name
    """The merged policy, told the true task."""
    routed: tuple[Name, ...] = Field(min_length=1)
    """The merged policy inferring the task, once for each router compared."""

    @model_validator(mode="before")
    @classmethod
    def _shorthand(cls, value: Any) -> Any:
        if isinstance(value, dict) and isinstance(value.get("routed"), str):
            return {**value, "routed": [value["routed"]]}
        return value

    def places(self) -> list[tuple[tuple[str | int, ...], str]]:
        """Every policy named, with where it stands in the file."""
        routed = [(("merging", "routed", i), name) for i, name in enumerate(self.routed)]
        return [(("merging", "expert"), self.expert), (("merging", "oracle_routed"), self.oracle_routed), *routed]


class CompareEntry(_Model):
    """Which of the suite's policies are set against which under perturbations."""

    baseline: Name
    others: tuple[Name, ...] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _shorthand(cls, value: Any) -> Any:
        if isinstance(value, dict) and isinstance(value.get("others"), str):
            return {**value, "others": [value["others"]]}
        return value

    def places(self) -> list[tuple[tuple[str | int, ...], str]]:
        """Every policy named, with where it stands in the file."""
        others = [(("compare", "others", i), name) for i, name in enumerate(self.others)]
        return [(("compare", "baseline"), self.baseline), *others]


class AdaptiveEntry(_Model):
    """When the comparison under a condition counts as decided, so that its episodes can be spent on the others."""

    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """Chance at most that a comparison without a difference is decided."""
    round: Count = 10
    """Seeds after which the evidence is looked at."""
    most: Count
    """Seeds of a condition at most; those of `seeds` are what each would have without stopping."""


class RegressionEntry(_Model):
    """How a run of the suite is held against an earlier one."""

    alpha: Annotated[float, Field(gt=0, lt=0.5)] = 0.05
    """Chance at most that a run without a change is called worse, and that it is called better."""
    margin: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """A rate that is lower by less than this counts as no worse."""


class Suite(_Model):
    """Tasks x policies x conditions x seeds, plus how to run and judge them."""

    name: Name
    description: str = ""
    policies: tuple[PolicyEntry, ...] = Field(min_length=1)
    tasks: tuple[str, ...] = Field(min_length=1)
    """`simulator/task`; a pattern such as `maniskill/*` stands for all tasks that match."""
    conditions: tuple[ConditionEntry, ...] = Field(default=(ConditionEntry.model_validate(CLEAN),), min_length=1)
    seeds: Seeds

    replan_every: Count = 8
    """Steps of an action chunk executed before the policy is asked again."""
    cameras: tuple[str, ...] = Field(default=CAMERAS, min_length=1)
    image_size: Annotated[int, Field(strict=True, ge=16, le=1024)] = 96
    render_profile: RenderProfile = RenderProfile.STANDARD
    horizon: Count | None = None
    """Control steps per episode, or each task's own."""

    workers: Annotated[
        Annotated[Count, Tag("int")]
        | Annotated[dict[str, Count], Tag("dict")]
        | Annotated[Literal["auto"], Tag("auto")],
        Discriminator(lambda value: {dict: "dict", str: "auto"}.get(type(value), "int")),
    ] = 1
    """Worker processes per simulator; "auto": as many for all simulators together as fit the cores and the memory."""
    resources: dict[str, Resources] = Field(default_factory=dict)
    """Simulator to what each of its workers needs; one core if nothing is said."""
    environments: dict[str, EnvironmentEntry] = Field(default_factory=dict)
    """Simulator to the Python environment that its workers run in; the running one if nothing is said. So are kinds of
    policies that compute in an environment of their own."""
    inference: Inference = Inference()
    max_attempts: Count = 3
    """Times that an episode may end its worker before it is recorded as an error."""
    episode_time_limit_s: Annotated[float, Field(gt=0, le=86_400)] = 120.0
    error_tolerance: Annotated[float, Field(ge=0, le=1)] = 0.1
    """Share of errors among the planned episodes at which the run ends early."""
    gate: Name | None = None
    """A policy that must solve an episode for it to count under a perturbation, for all policies alike: an oracle."""
    floors: tuple[Name, ...] = ()
    """Policies without skill: what the best of them achieves is taken off before the report says what share is kept."""
    merging: MergingEntry | None = None
    """Has the report say what merging and routing cost; no part of what is evaluated."""
    compare: CompareEntry | None = None
    """Has the report set policies against each other under perturbations; no part of what is evaluated. By default what
    `merging` names: the experts against the others."""

    adaptive: AdaptiveEntry | None = None
    """Has conditions stop when `compare` is decided there."""
    regression: RegressionEntry = RegressionEntry()
    """How `gauntlet compare` and `gauntlet gate` judge a run; no part of what is evaluated."""

    @property
    def comparison(self) -> CompareEntry | None:
        """Which policies are set against which under perturbations: `compare`, or what `merging` names."""
        if self.compare is None and self.merging is not None:
            others = (self.merging.oracle_routed, *self.merging.routed)
            return CompareEntry(baseline=self.merging.expert, others=others)
        return self.compare

    def worker_count(self, simulator: str) -> int:
        """Worker processes for that simulator; one if workers are not counted by simulator."""
        if isinstance(self.workers, dict):
            return self.workers.get(simulator, 1)
        return self.workers if isinstance(self.workers, int) else 1

    def with_names(self, names: KnownNames) -> Suite:
        """The suite with its task patterns replaced by the tasks they stand for."""
        return self.model_copy(update={"tasks": tuple(expand_tasks(self.tasks, names.tasks))})

    def all_conditions(self) -> list[Condition]:
        """Every condition, in the order of the file."""
        return [condition for entry in self.conditions for condition in entry.conditions()]

    def cells(self, names: KnownNames, digests: Mapping[str, str]) -> list[Cell]:
        """Every (policy, task, condition), tasks outermost so that neighbours share an open simulation.

        Args:
            names: Gives each task's horizon.
            digests: Policy name to the hash of its content.
        """
        view = View(self.cameras, self.image_size, self.render_profile)
        return [
            Cell(
                policy=policy.name,
                policy_digest=digests[policy.name],
                task=task,
                protocol=Protocol(self.horizon or names.tasks[task].horizon, self.replan_every, view),
                condition=condition,
            )
            for task in self.tasks
            for condition in self.all_conditions()
            for policy in self.policies
        ]

    def content_hash(self, digests: Mapping[str, str], names: KnownNames) -> str:
        """Hash of what is evaluated: the same for suites that plan the same episodes, however they are run."""
        cells = sorted(cell.episode(0).id for cell in self.cells(names, digests))
        evaluated: dict[str, Any] = {"cells": cells, "seeds": [self.seeds.start, self.seeds.count]}
        if self.adaptive is not None:
            sides = self.comparison
            evaluated["adaptive"] = [self.adaptive.model_dump(), sides.model_dump() if sides else None]
        return content_hash(evaluated)


def expand_tasks(patterns: Iterable[str], known: Mapping[str, KnownTask]) -> list[str]:
    """The task names that the patterns stand for, in their order; a plain name stands for itself."""
    expanded: list[str] = []
    for pattern in patterns:
        if any(sign in pattern for sign in "*?["):
            expanded += [task for task in known if fnmatchcase(task, pattern)]
        else:
            expanded.append(pattern)
    return expanded


def check_names(suite: Suite, names: KnownNames) -> list[tuple[tuple[str | int, ...], str]]:
    """Every name in the suite that does not exist, and every contradiction: (place in the file, message)."""
    problems: list[tuple[tuple[str | int, ...], str]] = []
    add = problems.append

    seen_policies: dict[str, int] = {}
    for i, policy in enumerate(suite.policies):
        place = ("policies", i)
        known = names.policies.get(policy.kind)
        if known is None:
            add((place, f"unknown policy '{policy.kind}'{nearest(policy.kind, names.policies)}"))
        else:
            for option in policy.options:
                if option not in known.options:
                    add((place, f"policy '{policy.kind}' has no option '{option}'{nearest(option, known.options)}"))
        first = seen_policies.get(policy.name)
        if first is not None:
            add((place, f"duplicate policy '{policy.name}', already at entry {first + 1}; give it another `name`"))
        seen_policies.setdefault(policy.name, i)

    seen_tasks: set[str] = set()
    for i, pattern in enumerate(suite.tasks):
        place = ("tasks", i)
        matches = [task for task in expand_tasks([pattern], names.tasks) if task in names.tasks]
        if not matches:
            add((place, _unknown_task(pattern, names)))
        for task in matches:
            if task in seen_tasks:
                add((place, f"duplicate task '{task}'"))
            seen_tasks.add(task)
            for policy in suite.policies:
                known = names.policies.get(policy.kind)
                if known and known.tasks is not None and task not in known.tasks:
                    add((place, f"policy '{policy.name}' cannot act in '{task}'"))

    seen_conditions: set[Condition] = set()
    for i, entry in enumerate(suite.conditions):
        place = ("conditions", i)
        if entry.axis != CLEAN and entry.axis not in names.axes:
            add((place, f"unknown condition '{entry.axis}'{nearest(entry.axis, [CLEAN, *names.axes])}"))
        for condition in entry.conditions():
            if entry.axis == CLEAN and condition.severity:
                add((place, "clean has severity 0 only"))
            if condition.severity > names.axes.get(entry.axis, MOST_SEVERE):
                add((place, f"'{entry.axis}' has severity {names.axes[entry.axis]} at most, got {condition.severity}"))
            if entry.axis in names.axes and not condition.severity:
                add(
                    (
                        place,
                        f"expected severities from 1 for '{entry.axis}', as {{axis: {entry.axis}, severities: [2, 4]}}",
                    )
                )
            if condition in seen_conditions:
                add((place, f"duplicate condition '{condition}'"))
            seen_conditions.add(condition)

    if Condition() not in seen_conditions:
        add((("conditions",), "no clean condition to compare the perturbed ones with; add clean"))

    for i, camera in enumerate(suite.cameras):
        if camera not in CAMERAS:
            add((("cameras", i), f"unknown camera '{camera}'{nearest(camera, CAMERAS)}"))
        elif camera in suite.cameras[:i]:
            add((("cameras", i), f"duplicate camera '{camera}'"))
    counted = suite.workers if isinstance(suite.workers, dict) else {}
    for key, simulator in [
        *(("workers", name) for name in counted),
        *(("resources", name) for name in suite.resources),
    ]:
        if simulator not in names.simulators:
            add(((key, simulator), f"unknown simulator '{simulator}'{nearest(simulator, names.shown.simulators)}"))
    housed = [name for name, policy in names.policies.items() if policy.housed]
    for name in suite.environments:
        if name not in [*names.simulators, *housed]:
            places = [*names.shown.simulators, *housed]
            add((("environments", name), f"unknown simulator '{name}'{nearest(name, places)}"))
    if suite.gate is not None and suite.gate not in seen_policies:
        message = f"gate names no policy of this suite: '{suite.gate}'{nearest(suite.gate, seen_policies)}"
        add((("gate",), message))
    for i, name in enumerate(suite.floors):
        if name not in seen_policies:
            add((("floors", i), f"floors names no policy of this suite: '{name}'{nearest(name, seen_policies)}"))
    if suite.adaptive is not None:
        if suite.comparison is None:
            add((("adaptive",), "nothing to decide; add compare: {baseline: POLICY, others: [POLICY]}"))
        if suite.adaptive.most < suite.seeds.count:
            add((("adaptive", "most"), f"expected {suite.seeds.count} seeds or more, got {suite.adaptive.most}"))
    for sides in (suite.merging, suite.compare):
        problems += _check_sides(sides, seen_policies) if sides else []
    return problems


def _check_sides(
    sides: MergingEntry | CompareEntry, policies: Iterable[str]
) -> list[tuple[tuple[str | int, ...], str]]:
    known = list(policies)
    problems: list[tuple[tuple[str | int, ...], str]] = []
    seen: set[str] = set()
    for place, name in sides.places():
        if name not in known:
            problems.append((place, f"{place[0]} names no policy of this suite: '{name}'{nearest(name, known)}"))
        elif name in seen:
            problems.append((place, f"{place[0]} names policy '{name}' twice; each side is another policy"))
        seen.add(name)
    return problems


def _unknown_task(pattern: str, names: KnownNames) -> str:
    simulator, slash, _ = pattern.partition("/")
    if not slash:
        return f"expected simulator/task, got '{pattern}'{nearest(pattern, names.shown.tasks)}"
    if simulator not in names.simulators:
        return f"unknown simulator '{simulator}' in '{pattern}'{nearest(simulator, names.shown.simulators)}"
    own = [task for task in names.tasks if task.startswith(f"{simulator}/")]
    return f"unknown task '{pattern}'{nearest(pattern, own)}"
