"""Turns a suite file into a plan, and determines its remaining work. Starts and writes nothing."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path

from robogauntlet import suites
from robogauntlet.adapters import catalog as simulators
from robogauntlet.adapters.contract import ActionSpec, ObservationSpec
from robogauntlet.adapters.scene_control import ADJUSTABLE
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.inference.first_answer import check_first_answer
from robogauntlet.orchestrator.runs.adaptive_stopping import Outcomes, Progression, Work, key_of, progression
from robogauntlet.policies import catalog as policies
from robogauntlet.policies.contract import PolicyError, PolicyMismatch, PolicyNotInstalled, PolicyUnreachable, check_fit
from robogauntlet.policies.function_policy import FunctionPolicy, StatefulFunctionPolicy
from robogauntlet.policies.references import FORMS, read_reference, with_options
from robogauntlet.results.run_document import PlannedCell, RunDocument, Unsupported
from robogauntlet.suites.axes import AXES, Axis, axis_of, why_unsupported
from robogauntlet.suites.checks import check_names
from robogauntlet.suites.episode import Cell
from robogauntlet.suites.loading import Problem, SuiteError, load_suite, policy_lines
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.registry import KnownPolicy, KnownTask, Registry
from robogauntlet.suites.schema import PolicyEntry, Suite
from robogauntlet.suites.selection import SelectionError, SuiteSelection
from robogauntlet.support.errors import BadInput, UserError

SHIPPED = Path(suites.__file__).parent
WHOLE = SuiteSelection()
UNKNOWN = "unknown until its policy servers answer"
NO_POLICY = "unknown until it has a policy"


class PlanError(UserError):
    """A suite that cannot be run; one line per problem."""


@dataclass(frozen=True)
class Plan:
    """A validated suite with everything resolved."""

    suite: Suite
    path: Path
    text: str
    """The suite file, word for word."""
    suite_hash: str
    """Or `UNKNOWN`, or `NO_POLICY`."""
    cells: tuple[Cell, ...]
    sources: Mapping[str, PolicySource]
    unavailable: Mapping[str, str]
    """Simulators of the suite that are not installed or whose environment is unsuitable, each with the reason."""
    unsupported: tuple[Unsupported, ...] = ()
    """Axes that some tasks of the suite do not support; their cells are not planned."""
    not_installed: Mapping[str, str] = field(default_factory=dict)
    """Policies whose packages are not installed, or whose server does not answer, each with the reason. Whether they
    fit the suite was not checked."""
    environments: EnvironmentResolver = field(default_factory=EnvironmentResolver, compare=False)
    """The environment of each simulator."""

    @property
    def simulators(self) -> list[str]:
        """Simulators of the suite, in its order."""
        return list(dict.fromkeys(cell.simulator for cell in self.cells))

    @property
    def episodes(self) -> int:
        """Number of planned episodes."""
        return len(self.cells) * self.suite.seeds.count

    def planned_cells(self, seeds: Mapping[Cell, int] | None = None) -> tuple[PlannedCell, ...]:
        """The plan as the run document holds it, with each cell's number of seeds, by default that of the suite."""
        return tuple(
            PlannedCell(
                simulator=cell.simulator,
                task=cell.task,
                policy=cell.policy,
                policy_digest=cell.policy_digest,
                axis=cell.condition.axis,
                severity=cell.condition.severity,
                planned=self.suite.seeds.count if seeds is None else seeds.get(cell, 0),
            )
            for cell in self.cells
        )


def find_suite(name: str) -> Path:
    """The path of a suite file, or of the shipped suite of that name.

    Raises:
        SuiteError: A name without a suffix that is neither.
    """
    path = Path(name)
    if path.suffix or path.exists():
        return path
    shipped = {file.stem: file for file in SHIPPED.glob("*.yaml")}
    if name not in shipped:
        message = f"no such file, and no shipped suite of that name{did_you_mean(name, shipped)}"
        raise SuiteError([Problem(name, None, message)])
    return shipped[name]


def load_registry() -> Registry:
    """All tasks and policies that entry points declare, installed or not."""
    return Registry(
        tasks={
            f"{simulator.name}/{task}": KnownTask(description.horizon, simulator.internal)
            for simulator in simulators.simulators().values()
            for task, description in simulator.tasks.items()
        },
        policies={
            kind.name: KnownPolicy(
                frozenset(kind.options),
                kind.tasks() if kind.tasks else None,
                bool(kind.requirements or kind.without_dependencies),
            )
            for kind in policies.kinds().values()
        },
        axes={axis.name: len(axis.levels) for axis in AXES.values()},
    )


def make_plan(
    path: Path,
    *,
    text: str | None = None,
    part: SuiteSelection = WHOLE,
    only: Sequence[str] = (),
    require_installed: bool = True,
) -> Plan:
    """Read, validate and resolve a suite.

    Args:
        path: The suite file.
        text: Its text, if it is not written yet; a run writes it.
        part: The part of the suite to plan. It may name policies that the suite lacks (see `read_reference`).
        only: Simulators that must be available.
        require_installed: Whether a simulator of the suite and the packages of its policies must be installed, and its
            policy servers answer, as a run requires. If not, what is missing is listed in the plan, and a suite that
            needs a policy has no cells.

    Raises:
        SuiteError: The file is wrong, or a policy of the part does not fit the suite.
        PlanError: The suite is valid but cannot be run.
        BadInput: The part names a policy that does not exist.
        PolicyError: The part names a checkpoint of the zoo that does not exist.
    """
    names = load_registry()
    try:
        loaded = load_suite(path, names, text)
    except SuiteError as error:
        raise SuiteError([*error.problems, *_policy_problems(path, text, error.rest)], error.rest) from None
    whole, part = _add_policies(loaded, part, path)
    if require_installed and not whole.policies:
        raise PlanError(needs_policy(path))
    try:
        suite = part.apply_to(whole)
    except SelectionError as error:
        raise PlanError(f"{path}: {error}") from None
    if mistakes := check_names(suite, names):  # of added policies
        raise SuiteError([Problem(str(path), None, message) for _, message in mistakes])
    environments = EnvironmentResolver(suite.environments)
    sources, not_installed, wrong = _resolve_policies(suite, environments, ask=require_installed)
    if require_installed:
        wrong = [(name, f"policy '{name}': {reason}") for name, reason in not_installed.items()] + wrong
    unsupported = _unsupported_axes(suite)
    unsupported_tasks = Counter(gap.axis for gap in unsupported)
    problems = [
        f"axis '{gap.axis}' is unsupported in {gap.task}: {gap.reason}"
        for gap in unsupported
        if unsupported_tasks[gap.axis] == len(suite.tasks)
    ]
    problems += _missing_cameras(suite)
    if problems or wrong:
        lines = policy_lines(path.read_text(encoding="utf-8") if text is None else text)
        located = [Problem(str(path), lines.get(name), message) for name, message in wrong]
        raise SuiteError([*located, *(Problem(str(path), None, problem) for problem in problems)])
    digests = {name: str(source.digest) for name, source in sources.items()}
    without = {(gap.axis, gap.task) for gap in unsupported}
    cells = tuple(cell for cell in suite.cells(names, digests) if (cell.condition.axis, cell.task) not in without)
    suite_hash = NO_POLICY if not digests else UNKNOWN
    if digests and all(source.digest for source in sources.values()):
        suite_hash = suite.content_hash(digests, names)
    simulator_names = dict.fromkeys(cell.simulator for cell in cells)
    return Plan(
        suite=suite,
        path=path,
        text=path.read_text(encoding="utf-8") if text is None else text,
        suite_hash=suite_hash,
        cells=cells,
        sources=sources,
        unavailable=_unavailable_simulators(simulator_names, environments, only, require_one=require_installed),
        not_installed=not_installed,
        unsupported=unsupported,
        environments=environments,
    )


def needs_policy(path: Path) -> str:
    """The message for a suite that is used without the policy that it needs."""
    return f"{path}: the suite needs a policy; add --policy with {FORMS}"


def _add_policies(suite: Suite, part: SuiteSelection, path: Path) -> tuple[Suite, SuiteSelection]:
    """Add the policies of `part` that the suite lacks, and return both; `part` then has the names of these policies.

    Raises:
        PlanError: A name that is neither a policy of the suite nor a reference.
        BadInput: There is no such policy.
        PolicyError: The zoo has no such checkpoint.
    """
    entries, chosen = {policy.name: policy for policy in suite.policies}, []
    for text in part.policies:
        if any(fnmatchcase(name, text) for name in entries):
            chosen.append(text)
            continue
        try:
            entry = read_reference(text)
        except BadInput:
            if entries and not set(text) & set(":/"):
                raise PlanError(f"{path}: the suite has no policy '{text}'{did_you_mean(text, entries)}") from None
            raise
        if entries.setdefault(entry.name, entry) != entry:
            raise BadInput(
                f"--policy {text}: another policy has the name '{entry.name}' too; name them in a suite file"
            )
        chosen.append(entry.name)
    if added := [entry for name, entry in entries.items() if name not in {policy.name for policy in suite.policies}]:
        listed = (*suite.policies, *with_options(added, part.options))
        suite = suite.model_copy(update={"policies": listed, "needs": None})
    elif part.options:
        raise BadInput("--option: expected --policy with a policy that the suite lacks, to which the option belongs")
    return suite, replace(part, policies=tuple(chosen))


def _policy_problems(path: Path, text: str | None, rest: Suite | None) -> list[Problem]:
    """What is wrong with the policies that can be read in a suite file with other mistakes."""
    if rest is None:
        return []
    lines = policy_lines(path.read_text(encoding="utf-8") if text is None else text)
    _, _, wrong = _resolve_policies(rest, EnvironmentResolver(rest.environments), ask=False)
    return [Problem(str(path), lines.get(name), message) for name, message in wrong]


def _resolve_policies(
    suite: Suite, environments: EnvironmentResolver, *, ask: bool
) -> tuple[dict[str, PolicySource], dict[str, str], list[tuple[str, str]]]:
    """The policies' sources; those that are not installed, with the reasons; name and message of those that are wrong.

    With `ask`, functions are asked once.
    """
    sources: dict[str, PolicySource] = {}
    not_installed: dict[str, str] = {}
    problems: list[tuple[str, str]] = []
    names_by_digest: dict[str, str] = {}
    for entry in suite.policies:
        try:
            source, missing = _resolve_policy(entry, suite, environments, ask=ask)
        except PolicyMismatch as error:
            problems.append((entry.name, f"policy '{entry.name}' does not fit: {error.reason}"))
            continue
        except PolicyError as error:
            problems.append((entry.name, f"policy '{entry.name}': {error.reason}"))
            continue
        sources[entry.name] = source
        if missing:
            not_installed[entry.name] = missing
        if source.digest is None:
            continue
        if (first := names_by_digest.setdefault(str(source.digest), entry.name)) != entry.name:
            problems.append((entry.name, f"policies '{first}' and '{entry.name}' are the same policy; remove one"))
    return sources, not_installed, problems


def _resolve_policy(
    entry: PolicyEntry, suite: Suite, environments: EnvironmentResolver, *, ask: bool
) -> tuple[PolicySource, str]:
    """Find what a policy is built from, and why it is not installed ("" if it is).

    Raises:
        PolicyError: The policy cannot be used.
        PolicyMismatch: It does not fit the suite.
    """
    try:
        options = environments.options(entry.kind, entry.options)
    except PolicyNotInstalled as error:
        try:
            digest = policies.digest(entry.kind, entry.options)
        except PolicyNotInstalled:
            raise error from None
        return PolicySource(entry.kind, entry.options, digest), str(error)
    try:
        source = PolicySource(entry.kind, options, policies.digest(entry.kind, options))
    except PolicyUnreachable as error:
        return PolicySource(entry.kind, options), str(error)
    find_spec = policies.find(entry.kind).spec
    try:
        policy = None if find_spec else policies.load(entry.kind, options)
        spec = policies.spec(entry.kind, options) if policy is None else policy.spec
    except PolicyNotInstalled as error:
        return source, str(error)
    check_fit(spec, ActionSpec(1.0, 1.0, 1.0), ObservationSpec(suite.cameras, suite.image_size))
    if ask and isinstance(policy, FunctionPolicy | StatefulFunctionPolicy):
        instruction = simulators.task_descriptions()[suite.tasks[0]].instruction
        check_first_answer(entry.name, policy.ask, suite.view, instruction)
    return source, ""


def _unsupported_axes(suite: Suite) -> tuple[Unsupported, ...]:
    """Pairs of an axis of the suite and a task that does not support it."""
    cards = simulators.task_descriptions()
    axes = dict.fromkeys(filter(None, map(axis_of, suite.all_conditions())))
    return tuple(
        Unsupported(axis=axis.name, task=task, reason=reason)
        for axis in axes
        for task in suite.tasks
        if (reason := why_unadjusted(axis, task) or why_unsupported(axis, cards[task].instruction))
    )


def _missing_cameras(suite: Suite) -> Iterator[str]:
    """A line for each task that lacks a camera of the suite."""
    cards = simulators.task_descriptions()
    for task in suite.tasks:
        for camera in suite.cameras:
            if camera not in cards[task].cameras:
                yield f"task '{task}' has no camera '{camera}'; write cameras: [{', '.join(cards[task].cameras)}]"


def _unavailable_simulators(
    names: Collection[str], environments: EnvironmentResolver, required: Sequence[str], *, require_one: bool
) -> dict[str, str]:
    """The simulators that cannot run on this machine, each with the reason.

    Raises:
        PlanError: A required simulator is not in the suite or cannot run; with `require_one`, none can run.
    """
    unavailable = {name: reason for name in names if (reason := environments.missing_reason(simulators.find(name)))}
    unused = [name for name in required if name not in names]
    none_can_run = len(unavailable) == len(names)
    broken = unavailable if require_one and none_can_run else [name for name in required if name in unavailable]
    problems = [f"{name}: the suite does not use this simulator{did_you_mean(name, names)}" for name in unused]
    problems += [f"{name}: {unavailable[name]}" for name in broken]
    if problems:
        raise PlanError("\n".join(problems))
    return unavailable


def remaining_work(plan: Plan, outcomes: Outcomes, skipped: Collection[str] = ()) -> Progression:
    """The remaining work of a plan; for an adaptive suite, of the current round. `skipped` are further simulators."""
    suite, sides = plan.suite, plan.suite.comparison
    cells = [cell for cell in plan.cells if cell.simulator not in {*plan.unavailable, *skipped}]
    if suite.adaptive is not None and sides is not None:
        return progression(cells, suite.seeds, suite.adaptive, sides, outcomes)
    work: Work = []
    for cell in cells:
        played = outcomes.get(key_of(cell), {})
        if missing := array("q", (seed for seed in suite.seeds if seed not in played)):
            work.append((cell, missing))
    return Progression(work, planned=dict.fromkeys(plan.cells, suite.seeds.count))


def why_unadjusted(axis: Axis, task: str) -> str | None:
    """Why a task does not support an axis that changes the scene, or None."""
    part, simulator = str(axis.changes), simulators.find(task.partition("/")[0])
    if part in ADJUSTABLE and part not in simulator.adjusts:
        return f"{simulator.title} does not let its {part} be adjusted"
    return simulators.task_descriptions()[task].fixed.get(part)


def check_same(plan: Plan, document: RunDocument, folder: Path) -> None:
    """Refuse to continue a run with another suite or with changed policies.

    Raises:
        PlanError: The plan differs from the run; the message says how.
    """
    if plan.suite_hash == document.suite_hash:
        return
    begun = {cell.policy: cell.policy_digest for cell in document.plan}
    changed = [name for name, source in plan.sources.items() if begun.get(name, source.digest) != source.digest]
    if document.suite.name != plan.suite.name:
        why = f"it holds a run of suite '{document.suite.name}', not '{plan.suite.name}'"
    elif changed:
        why = f"policy '{changed[0]}' has changed since the run was begun"
    else:
        why = f"suite '{plan.suite.name}' plans other episodes than when the run was begun"
    raise PlanError(f"{folder}: {why}; give another folder with --out")
