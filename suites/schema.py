"""The validated content of a suite file. A `Registry` gives the names that exist, so nothing is imported."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticKnownError

from robogauntlet.suites.conditions import condition_of, read_severities
from robogauntlet.suites.designs import DesignEntry, Severity
from robogauntlet.suites.environments import EnvironmentEntry
from robogauntlet.suites.episode import (
    AT,
    CAMERAS,
    CLEAN,
    CONTROLS,
    Cell,
    Condition,
    Protocol,
    ProtocolName,
    RenderProfile,
    SuccessRule,
    View,
    content_hash,
)
from robogauntlet.suites.ranges import (
    MAX_ENTRIES,
    MAX_NAME,
    Attempts,
    FirstSeed,
    ImageSize,
    SeedNumber,
    StatedTiming,
    Steps,
    Text,
    Workers,
)
from robogauntlet.suites.registry import KnownTask, Registry
from robogauntlet.suites.resources import Inference, Resources
from robogauntlet.suites.yaml_file import Place

SHORT_FORMS = {"openpi": "address", "vla-eval": "address", "python": "callable", "lerobot": "checkpoint"}
"""Kind of policy to the option that may follow it after a colon. Others have an address, `KIND://...`."""
Name = Annotated[str, Field(strict=True, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=MAX_NAME)]
Names = Annotated[
    tuple[Name, ...], BeforeValidator(lambda value: [value] if isinstance(value, str) else value), Field(min_length=1)
]
"""A name, or a list of them."""
Mistake = tuple[Place, str]
"""Place in the file, and message."""


def policy_entry(text: str) -> dict[str, Any]:
    """Return the entry of a text: a kind, or a kind with its one option and a name made of both.

    Examples: `oracle`, `openpi://HOST:PORT`, `KIND+http://HOST:PORT`, `python:module:Name`.
    """
    kind, _, rest = text.partition(":")
    is_address = rest.startswith("//")
    if is_address:
        kind = "openpi" if kind in ("ws", "wss") else kind.partition("+")[0]
    option = "address" if is_address else SHORT_FORMS.get(kind)
    if option is None or not kind or not rest:
        return {"name": text, "kind": text}
    value = text if is_address else rest
    shown = re.sub("//[^/]*@", "//", text)  # no user or password of an address
    return {"name": valid_name(shown), "kind": kind, "options": {option: value}}


def valid_name(text: str) -> str:
    """Return a text as a name, with hyphens for characters that names may not have; "" if no character is left.

    A longer text ends with a hash, so that texts that begin alike have different names.
    """
    name = re.sub(r"[^A-Za-z0-9._]+", "-", text).strip("-._")
    return name if len(name) <= MAX_NAME else f"{name[: MAX_NAME - 9]}-{content_hash(text, length=8)}"


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PolicyEntry(_Model):
    """A policy of the suite: its kind, its options, and the name under which it is reported."""

    name: Name
    kind: Text
    options: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _shorthand(cls, value: Any) -> Any:
        if isinstance(value, str):
            return policy_entry(value)
        if isinstance(value, dict) and "kind" in value:
            kind = value["kind"]
            return {"name": kind if isinstance(kind, str) else "policy", **value}
        return value


class ConditionEntry(_Model):
    """A perturbation axis with the severities to run, `clean`, a control, or a combination.

    A combination is written `{camera-orbit: 2, illuminance: 3.5}` or `camera-orbit@2+illuminance@3.5`, which is its
    `axis`, see `Condition`.
    """

    axis: Text
    severities: tuple[Annotated[Severity, Field(ge=0, le=5)], ...] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _shorthand(cls, value: Any) -> Any:
        if isinstance(value, dict) and value and "axis" not in value and "severities" not in value:
            value = _combination(value)
        if not isinstance(value, str):
            return value
        axis, severities = read_severities(value)
        # A name alone is clean or a control; severity 0 of anything else is refused when names are checked.
        return {"axis": axis, "severities": [int(axis in CONTROLS)] if severities is None else severities}

    def conditions(self) -> list[Condition]:
        """One condition per severity."""
        return [condition_of(self.axis, severity) for severity in self.severities]


def _combination(value: dict[Any, Any]) -> str:
    """The text of a combination that is given as a mapping of axes to severities."""
    for axis, severity in value.items():
        if isinstance(severity, bool) or not isinstance(severity, int | float) or not 0.01 <= severity <= 5:
            raise ValueError(f"expected a severity above 0 and up to 5 for '{axis}', got {severity!r}")
    return "+".join(f"{axis}@{severity:.9f}" for axis, severity in value.items())


class Seeds(_Model):
    """A block of consecutive seeds."""

    start: FirstSeed = 0
    count: SeedNumber

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
            elif isinstance(value, tuple):
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
    """Policies that are compared with a baseline, on clean episodes and under perturbations."""

    key = "compare"
    baseline: Name
    others: Names
    margin: Annotated[float, Field(gt=0, lt=1)] | None = None
    """A difference of success rates below this counts as none: under perturbations, equivalence within it is tested."""


class AdaptiveEntry(_Model):
    """The rule that stops a condition when its comparison is decided, so that others get its episodes."""

    alpha: Annotated[float, Field(gt=0, lt=1)] = 0.05
    """Largest probability that a comparison without a difference is decided."""
    round: SeedNumber = 10
    """Seeds between two evaluations of the evidence."""
    max_seeds: SeedNumber
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
    description: Text = ""
    needs: Literal["policy"] | None = None
    """`policy` for a suite that is run with `--policy`; its own policies are `reference_policies` at most."""
    policies: tuple[PolicyEntry, ...] = Field(default=(), max_length=MAX_ENTRIES, validate_default=True)
    tasks: tuple[Text, ...] = Field(min_length=1, max_length=MAX_ENTRIES)
    """`simulator/task`, or a pattern such as `maniskill/*`."""
    robots: tuple[Text, ...] = Field(default=(), max_length=MAX_ENTRIES)
    """Robots that play each of the tasks; by default the one that its name says."""
    conditions: tuple[ConditionEntry, ...] = Field(default=(ConditionEntry.model_validate(CLEAN),), min_length=1)
    design: DesignEntry | None = None
    """Combinations of axes, besides `conditions`."""
    seeds: Seeds

    protocol: ProtocolName = ProtocolName.ROBOGAUNTLET
    """`openvla`: the common protocol of LIBERO, for its tasks."""
    success: SuccessRule | None = None
    """When an episode is a success; by default as the protocol says: held, under openvla once."""
    timing: StatedTiming = None
    """How long answers take in simulated time and what the robot does meanwhile, such as `continue:80ms`, see
    `read_timing`. By default the simulation waits for them."""
    replan_every: Steps = 8
    """Steps of an action chunk executed before the policy is queried again."""
    cameras: tuple[Text, ...] = Field(default=CAMERAS, min_length=1)
    image_size: ImageSize = 96
    render_profile: RenderProfile = RenderProfile.STANDARD
    horizon: Steps | None = None
    """Control steps per episode, or each task's own."""

    workers: Annotated[
        Annotated[Workers, Tag("int")]
        | Annotated[dict[str, Workers], Tag("dict")]
        | Annotated[Literal["auto"], Tag("auto")],
        Discriminator(lambda value: {dict: "dict", str: "auto"}.get(type(value), "int")),
    ] = "auto"
    """Worker processes per simulator; "auto": as many for all simulators together as cores and memory allow."""
    resources: dict[str, Resources] = Field(default_factory=dict)
    """Simulator to the needs of each of its workers; one core by default."""
    environments: dict[str, EnvironmentEntry] = Field(default_factory=dict)
    """Simulator, or kind of policy with its own environment, to its Python environment; the running one by default."""
    inference: Inference = Inference()
    max_attempts: Attempts = 3
    """Workers that an episode may crash before it is recorded as an error."""
    episode_time_limit_s: Annotated[float, Field(ge=1, le=86_400)] = 120.0
    error_tolerance: Annotated[float, Field(ge=0, le=1)] = 0.1
    """Share of errors among the planned episodes at which the run ends early."""
    oracle_gate: Name | None = None
    """An oracle that must solve a perturbed episode for it to count, for all policies."""
    no_skill_baselines: tuple[Name, ...] = ()
    """Policies without skill: the report subtracts the best of their rates before it computes the retained share."""
    merging: MergingEntry | None = None
    """Adds the cost of merging and routing to the report; does not affect the episodes."""
    compare: CompareEntry | None = None
    """Which policies the report compares with which; by default experts with the other policies of `merging`."""

    adaptive: AdaptiveEntry | None = None
    """Stops conditions in which `compare` is decided."""
    regression: RegressionEntry = RegressionEntry()
    """Settings of `robogauntlet compare`; do not affect the episodes."""

    @field_validator("policies", mode="before")
    @classmethod
    def _present_or_needed(cls, value: Any, info: ValidationInfo) -> Any:
        if info.data.get("needs") is None:
            if value == ():
                raise PydanticKnownError("missing")
            if value == []:
                raise PydanticKnownError("too_short", {"field_type": "Tuple", "min_length": 1, "actual_length": 0})
        return value

    @property
    def reference_policies(self) -> tuple[str, ...]:
        """Names of the oracle gate and the baselines without skill, against which the others are measured."""
        return (*([self.oracle_gate] if self.oracle_gate is not None else []), *self.no_skill_baselines)

    @property
    def comparison(self) -> CompareEntry | None:
        """The comparison with a baseline: `compare`, or the policies of `merging`."""
        if self.compare is not None or self.merging is None:
            return self.compare
        others = (self.merging.oracle_routed, *self.merging.routed)
        return CompareEntry(baseline=self.merging.expert, others=others)

    def worker_count(self, simulator: str) -> int:
        """Return the worker processes of a simulator, unless all share them; one where `workers` does not name it."""
        if isinstance(self.workers, dict):
            return self.workers.get(simulator, 1)
        return self.workers if isinstance(self.workers, int) else 1

    @property
    def view(self) -> View:
        """The images that policies see."""
        return View(self.cameras, self.image_size, self.render_profile)

    def protocol_with(self, horizon: int) -> Protocol:
        """The rules of an episode of a task with this horizon, if the suite states no other."""
        rules = self.protocol, self.success, self.timing
        return Protocol(self.horizon or horizon, self.replan_every, self.view, *rules)

    @property
    def success_rule(self) -> SuccessRule:
        """When an episode is a success."""
        return self.success or self.protocol.success_rule

    def with_names(self, names: Registry) -> Suite:
        """Return the suite with its task patterns and its robots replaced by task names."""
        able = robots_by_task(names.tasks) if self.robots else {}  # reads all tasks, of which there are ten thousand
        tasks = with_robots(expand_tasks(self.tasks, names.tasks), self.robots, able)
        return self.model_copy(update={"tasks": tuple(tasks), "robots": ()})

    def all_conditions(self) -> list[Condition]:
        """Return every condition once, in the order of the file; those of the design come last."""
        listed = [condition for entry in self.conditions for condition in entry.conditions()]
        return list(dict.fromkeys([*listed, *(self.design.conditions() if self.design else ())]))

    def cells(self, names: Registry, digests: Mapping[str, str]) -> list[Cell]:
        """Return every (policy, task, condition), by task so that neighbours share an open simulation.

        `digests` has the hash of each policy's content.
        """
        cells = []
        for task in self.tasks:
            protocol = self.protocol_with(names.tasks[task].horizon)
            for condition in self.all_conditions():
                cells += [Cell(p.name, digests[p.name], task, protocol, condition) for p in self.policies]
        return cells

    def content_hash(self, digests: Mapping[str, str], names: Registry) -> str:
        """Hash the planned episodes: equal for suites with the same episodes, however they are run."""
        cells = sorted(cell.episode(0).id for cell in self.cells(names, digests))
        evaluated: dict[str, Any] = {"cells": cells, "seeds": [self.seeds.start, self.seeds.count]}
        if self.adaptive is not None:
            sides = self.comparison
            evaluated["adaptive"] = [
                self.adaptive.model_dump(),
                sides.model_dump(exclude={"margin"}) if sides else None,
            ]
        return content_hash(evaluated)


def _matches(task: str, pattern: str) -> bool:
    return (AT not in task or AT in pattern) and fnmatchcase(task, pattern)


def is_plain(pattern: str) -> bool:
    """Return whether a task is named, not described by a pattern."""
    return not set(pattern) & set("*?[")


def expand_tasks(patterns: Iterable[str], known: Mapping[str, KnownTask]) -> list[str]:
    """Return the names of the tasks that match the patterns, in their order; a plain name is kept.

    Tasks that name their arm (`robosuite/Lift@UR5e`) match patterns that do so too (`robosuite/*@*`).
    """
    expanded: list[str] = []
    for pattern in dict.fromkeys(patterns):
        expanded += [pattern] if is_plain(pattern) else [task for task in known if _matches(task, pattern)]
    return expanded


def robots_by_task(known: Mapping[str, KnownTask]) -> dict[str, dict[str, str]]:
    """Task without its robot, to the robots that play it and the names of the task with each."""
    found: dict[str, dict[str, str]] = {}
    for name, task in known.items():
        if task.robot:
            found.setdefault(name.partition(AT)[0], {})[task.robot] = name
    return found


def with_robots(tasks: Iterable[str], robots: Iterable[str], able: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return the names of the tasks when each is played by each of the robots, or by its own if there are none.

    `able` is that of `robots_by_task`. A robot that cannot play a task is left out.
    """
    wanted = tuple(robots)
    if not wanted:
        return list(tasks)
    named = (able.get(task.partition(AT)[0], {}).get(robot) for task in tasks for robot in wanted)
    return [name for name in named if name]
