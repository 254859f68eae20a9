"""The validated content of a suite file. A `Registry` gives the names that exist, so nothing is imported."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from itertools import chain
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from robogauntlet.suites.environments import EnvironmentEntry
from robogauntlet.suites.episode import (
    CAMERAS,
    CLEAN,
    CONTROLS,
    Cell,
    Condition,
    Protocol,
    RenderProfile,
    View,
    content_hash,
)
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.registry import KnownTask, Registry
from robogauntlet.suites.resources import Inference, Resources

MOST_SEVERE = 5
SHORT_FORMS = {"openpi": "address", "python": "callable", "lerobot": "checkpoint"}
"""Kind of policy to the option that may follow it after a colon."""
LONGEST_NAME = 80
Count = Annotated[int, Field(strict=True, ge=1)]
Name = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=LONGEST_NAME)]
Names = Annotated[
    tuple[Name, ...], BeforeValidator(lambda value: [value] if isinstance(value, str) else value), Field(min_length=1)
]
"""A name, or a list of them."""
Place = tuple[str | int, ...]
"""Keys and list indices of a value in the file."""
Mistake = tuple[Place, str]
"""Place in the file, and message."""


def policy_entry(text: str) -> dict[str, Any]:
    """Return the entry of a text: a kind, or a kind with its one option and a name made of both.

    Examples: `oracle`, `openpi://HOST:PORT`, `python:module:Name`.
    """
    kind, colon, rest = text.partition(":")
    if not colon or kind not in SHORT_FORMS or not rest:
        return {"name": text, "kind": text}
    value = text if rest.startswith("//") else rest
    return {"name": valid_name(text), "kind": kind, "options": {SHORT_FORMS[kind]: value}}


def valid_name(text: str) -> str:
    """Return a text as a name, with hyphens for characters that names may not have; "" if no character is left."""
    return re.sub(r"[^A-Za-z0-9._]+", "-", text)[:LONGEST_NAME].strip("-._")


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PolicyEntry(_Model):
    """A policy of the suite: its kind, its options, and the name under which it is reported."""

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


class _Sides(_Model):
    """Names of policies that are compared."""

    key: ClassVar[str]
    """The entry's key in the suite file."""

    def places(self) -> list[Mistake]:
        """Return every policy name with its place in the file."""
        places: list[Mistake] = []
        for field, value in self:
            if isinstance(value, str):
                places.append(((self.key, field), value))
            else:
                places += [((self.key, field, i), name) for i, name in enumerate(value)]
        return places


class MergingEntry(_Sides):
    """The roles of the suite's policies in a comparison of experts with the model merged from them."""

    key = "merging"
    expert: Name
    """The experts, each in its own task."""
    oracle_routed: Name
    """The merged policy that is given the true task."""
    routed: Names
    """The merged policy inferring the task, once for each router compared."""


class CompareEntry(_Sides):
    """Policies that are compared under perturbations."""

    key = "compare"
    baseline: Name
    others: Names


class AdaptiveEntry(_Model):
    """The rule that stops a condition when its comparison is decided, so that others get its episodes."""

    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """Largest probability that a comparison without a difference is decided."""
    round: Count = 10
    """Seeds between two evaluations of the evidence."""
    max_seeds: Count
    """Maximum number of seeds of a condition; without stopping, each has those of `seeds`."""


class RegressionEntry(_Model):
    """How a run of the suite is compared with an earlier one."""

    alpha: Annotated[float, Field(gt=0, lt=0.5)] = 0.05
    """Largest probability that an unchanged run is called worse, and that it is called better."""
    margin: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """A rate that is lower by less than this counts as no worse."""


class Suite(_Model):
    """Tasks x policies x conditions x seeds, and how they are run and compared."""

    name: Name
    description: str = ""
    policies: tuple[PolicyEntry, ...] = Field(min_length=1)
    tasks: tuple[str, ...] = Field(min_length=1)
    """`simulator/task`, or a pattern such as `maniskill/*`."""
    conditions: tuple[ConditionEntry, ...] = Field(default=(ConditionEntry.model_validate(CLEAN),), min_length=1)
    seeds: Seeds

    replan_every: Count = 8
    """Steps of an action chunk executed before the policy is queried again."""
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
    ] = "auto"
    """Worker processes per simulator; "auto": as many for all simulators together as cores and memory allow."""
    resources: dict[str, Resources] = Field(default_factory=dict)
    """Simulator to the needs of each of its workers; one core by default."""
    environments: dict[str, EnvironmentEntry] = Field(default_factory=dict)
    """Simulator, or kind of policy with its own environment, to its Python environment; the running one by default."""
    inference: Inference = Inference()
    max_attempts: Count = 3
    """Workers that an episode may crash before it is recorded as an error."""
    episode_time_limit_s: Annotated[float, Field(gt=0, le=86_400)] = 120.0
    error_tolerance: Annotated[float, Field(ge=0, le=1)] = 0.1
    """Share of errors among the planned episodes at which the run ends early."""
    oracle_gate: Name | None = None
    """An oracle that must solve a perturbed episode for it to count, for all policies."""
    no_skill_baselines: tuple[Name, ...] = ()
    """Policies without skill: the report subtracts the best of their rates before it computes the retained share."""
    merging: MergingEntry | None = None
    """Adds the cost of merging and routing to the report; does not affect the episodes."""
    compare: CompareEntry | None = None
    """Adds a comparison under perturbations to the report; by default experts with the other policies of `merging`."""

    adaptive: AdaptiveEntry | None = None
    """Stops conditions in which `compare` is decided."""
    regression: RegressionEntry = RegressionEntry()
    """Settings of `robogauntlet compare` and `robogauntlet gate`; do not affect the episodes."""

    @property
    def comparison(self) -> CompareEntry | None:
        """The comparison under perturbations: `compare`, or the policies of `merging`."""
        if self.compare is not None or self.merging is None:
            return self.compare
        others = (self.merging.oracle_routed, *self.merging.routed)
        return CompareEntry(baseline=self.merging.expert, others=others)

    def worker_count(self, simulator: str) -> int:
        """Return the worker processes of a simulator, unless all share them; one where `workers` does not name it."""
        if isinstance(self.workers, dict):
            return self.workers.get(simulator, 1)
        return self.workers if isinstance(self.workers, int) else 1

    def with_names(self, names: Registry) -> Suite:
        """Return the suite with its task patterns replaced by task names."""
        return self.model_copy(update={"tasks": tuple(expand_tasks(self.tasks, names.tasks))})

    def all_conditions(self) -> list[Condition]:
        """Return every condition, in the order of the file."""
        return [condition for entry in self.conditions for condition in entry.conditions()]

    def cells(self, names: Registry, digests: Mapping[str, str]) -> list[Cell]:
        """Return every (policy, task, condition), by task so that neighbours share an open simulation.

        `digests` has the hash of each policy's content.
        """
        view = View(self.cameras, self.image_size, self.render_profile)
        cells = []
        for task in self.tasks:
            protocol = Protocol(self.horizon or names.tasks[task].horizon, self.replan_every, view)
            for condition in self.all_conditions():
                cells += [Cell(p.name, digests[p.name], task, protocol, condition) for p in self.policies]
        return cells

    def content_hash(self, digests: Mapping[str, str], names: Registry) -> str:
        """Hash the planned episodes: equal for suites with the same episodes, however they are run."""
        cells = sorted(cell.episode(0).id for cell in self.cells(names, digests))
        evaluated: dict[str, Any] = {"cells": cells, "seeds": [self.seeds.start, self.seeds.count]}
        if self.adaptive is not None:
            sides = self.comparison
            evaluated["adaptive"] = [self.adaptive.model_dump(), sides.model_dump() if sides else None]
        return content_hash(evaluated)


def expand_tasks(patterns: Iterable[str], known: Mapping[str, KnownTask]) -> list[str]:
    """Return the names of the tasks that match the patterns, in their order; a plain name is kept."""
    expanded: list[str] = []
    for pattern in patterns:
        is_plain = not set(pattern) & set("*?[")
        expanded += [pattern] if is_plain else [task for task in known if fnmatchcase(task, pattern)]
    return expanded


def check_names(suite: Suite, names: Registry) -> list[Mistake]:
    """Return a mistake for every name that does not exist and for every contradiction."""
    return [
        *_check_policies(suite, names),
        *_check_tasks(suite, names),
        *_check_conditions(suite, names),
        *_check_cameras(suite),
        *_check_simulators(suite, names),
        *_check_roles(suite),
        *_check_adaptive(suite),
    ]


def _check_policies(suite: Suite, names: Registry) -> Iterator[Mistake]:
    seen: dict[str, int] = {}
    for i, policy in enumerate(suite.policies):
        place = ("policies", i)
        known = names.policies.get(policy.kind)
        if known is None:
            yield place, f"unknown policy '{policy.kind}'{did_you_mean(policy.kind, names.policies)}"
        else:
            for option in policy.options:
                if option not in known.options:
                    yield place, f"policy '{policy.kind}' has no option '{option}'{did_you_mean(option, known.options)}"
        first = seen.setdefault(policy.name, i)
        if first != i:
            yield place, f"duplicate policy '{policy.name}', already at entry {first + 1}; give it another `name`"


def _check_tasks(suite: Suite, names: Registry) -> Iterator[Mistake]:
    seen: set[str] = set()
    for i, pattern in enumerate(suite.tasks):
        place = ("tasks", i)
        matches = [task for task in expand_tasks([pattern], names.tasks) if task in names.tasks]
        if not matches:
            yield place, _unknown_task(pattern, names)
        for task in matches:
            if task in seen:
                yield place, f"duplicate task '{task}'"
            seen.add(task)
            for policy in suite.policies:
                known = names.policies.get(policy.kind)
                if known and known.tasks is not None and task not in known.tasks:
                    yield place, f"policy '{policy.name}' cannot act in '{task}'"


def _unknown_task(pattern: str, names: Registry) -> str:
    simulator, slash, _ = pattern.partition("/")
    if not slash:
        return f"expected simulator/task, got '{pattern}'{did_you_mean(pattern, names.public.tasks)}"
    if simulator not in names.simulators:
        return f"unknown simulator '{simulator}' in '{pattern}'{did_you_mean(simulator, names.public.simulators)}"
    tasks = [task for task in names.tasks if task.startswith(f"{simulator}/")]
    return f"unknown task '{pattern}'{did_you_mean(pattern, tasks)}"


def _check_conditions(suite: Suite, names: Registry) -> Iterator[Mistake]:
    seen: set[Condition] = set()
    for i, entry in enumerate(suite.conditions):
        place, axis = ("conditions", i), entry.axis
        if axis != CLEAN and axis not in names.axes:
            yield place, f"unknown condition '{axis}'{did_you_mean(axis, [CLEAN, *names.axes])}"
        for condition in entry.conditions():
            if axis == CLEAN and condition.severity:
                yield place, "clean has severity 0 only"
            if condition.severity > names.axes.get(axis, MOST_SEVERE):
                yield place, f"'{axis}' has severity {names.axes[axis]} at most, got {condition.severity}"
            if axis in names.axes and not condition.severity:
                yield place, f"expected severities from 1 for '{axis}', as {{axis: {axis}, severities: [2, 4]}}"
            if condition in seen:
                yield place, f"duplicate condition '{condition}'"
            seen.add(condition)
    if Condition() not in seen:
        yield ("conditions",), "no clean condition to compare the perturbed ones with; add clean"


def _check_cameras(suite: Suite) -> Iterator[Mistake]:
    for i, camera in enumerate(suite.cameras):
        if camera not in CAMERAS:
            yield ("cameras", i), f"unknown camera '{camera}'{did_you_mean(camera, CAMERAS)}"
        elif camera in suite.cameras[:i]:
            yield ("cameras", i), f"duplicate camera '{camera}'"


def _check_simulators(suite: Suite, names: Registry) -> Iterator[Mistake]:
    """Simulators in `workers`, `resources` and `environments`; the last may hold kinds of policies too."""
    kinds = [name for name, policy in names.policies.items() if policy.has_environment]
    keys: list[tuple[str, Iterable[str], list[str]]] = [
        ("workers", suite.workers if isinstance(suite.workers, dict) else (), []),
        ("resources", suite.resources, []),
        ("environments", suite.environments, kinds),
    ]
    for key, given, others in keys:
        for name in given:
            if name not in names.simulators and name not in others:
                near = did_you_mean(name, [*names.public.simulators, *others])
                yield (key, name), f"unknown simulator '{name}'{near}"


def _check_roles(suite: Suite) -> Iterator[Mistake]:
    """Policies named in `oracle_gate`, `no_skill_baselines`, `merging` and `compare`."""
    known = [policy.name for policy in suite.policies]
    gate: list[Mistake] = [(("oracle_gate",), suite.oracle_gate)] if suite.oracle_gate is not None else []
    baselines = [(("no_skill_baselines", i), name) for i, name in enumerate(suite.no_skill_baselines)]
    sides = [entry.places() for entry in (suite.merging, suite.compare) if entry]
    for place, name in chain(gate, baselines, *sides):
        if name not in known:
            yield place, f"{place[0]} names no policy of this suite: '{name}'{did_you_mean(name, known)}"
    for places in sides:
        names = [name for _, name in places]
        for i, (place, name) in enumerate(places):
            if name in known and name in names[:i]:
                yield place, f"{place[0]} names policy '{name}' twice; each side is another policy"


def _check_adaptive(suite: Suite) -> Iterator[Mistake]:
    if suite.adaptive is None:
        return
    if suite.comparison is None:
        yield ("adaptive",), "nothing to decide; add compare: {baseline: POLICY, others: [POLICY]}"
    if suite.adaptive.max_seeds < suite.seeds.count:
        yield ("adaptive", "max_seeds"), f"expected {suite.seeds.count} seeds or more, got {suite.adaptive.max_seeds}"
