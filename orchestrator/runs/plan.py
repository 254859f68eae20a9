"""Turns a suite file into a plan, and determines its remaining work. Starts and writes nothing."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from robogauntlet.adapters import catalog as simulators
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.registry import load_registry, why_unadjusted
from robogauntlet.orchestrator.runs.adaptive_stopping import Outcomes, Progression, Work, key_of, progression
from robogauntlet.orchestrator.runs.suite_policies import PlanError, add_policies, find_policies, needs_policy, of_tasks
from robogauntlet.results.run_document import PlannedCell, RunDocument, Unsupported
from robogauntlet.suites.axes import axes_of, why_unsupported
from robogauntlet.suites.checks import check_names, training_seeds
from robogauntlet.suites.episode import Cell
from robogauntlet.suites.loading import REQUIRED, SuiteError, load_suite, problem_at
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.schema import Suite
from robogauntlet.suites.selection import SelectionError, SuiteSelection
from robogauntlet.support.text import counted, first_of

WHOLE = SuiteSelection()
UNKNOWN = "unknown until its policies can be identified"
NO_POLICY = "unknown until it has a policy"


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
    unchecked: Mapping[str, str] = field(default_factory=dict)
    """Policies of which it was not checked whether they fit the suite, each with the reason: a package is not
    installed, a server does not answer, or nothing was started."""
    left_out: tuple[str, ...] = ()
    """Tasks of a suite that needs a policy in which a policy that was added to it cannot act."""
    notes: tuple[str, ...] = ()
    """What of the suite was chosen as its policies ask, a line each."""
    warnings: tuple[str, ...] = ()
    """What its policies ask for and do not get, what cannot be told of them, and what its seeds cannot show, a
    line each."""
    server_metadata: Mapping[str, str] = field(default_factory=dict)
    """Policies with an identity to the hash of what their servers say of themselves."""
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


def fitted(plan: Plan) -> Iterator[str]:
    """Yield a line for each change to a suite which makes it fit its policies."""
    if plan.left_out:
        tasks = counted(len(plan.left_out), "task")
        yield f"{plan.suite.name}: {tasks} left out, in which a policy cannot act: {first_of(plan.left_out)}"
    yield from (f"{plan.suite.name}: {note}" for note in plan.notes)


def make_plan(
    path: Path,
    *,
    text: str | None = None,
    part: SuiteSelection = WHOLE,
    only: Sequence[str] = (),
    require_installed: bool = True,
    start: bool = True,
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
        start: Whether to import code that the suite names, contact its policy servers and start interpreters of
            environments, as a run does.

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
        if error.rest is None:
            raise
        rest = error.rest.with_names(names)
        known = list(rest.tasks) != REQUIRED["tasks"]
        others = find_policies(rest, EnvironmentResolver(rest.environments), start=start, tasks_are_known=known)
        raise SuiteError([*error.problems, *others.problems(path, _text(path, text))], rest) from None
    try:
        loaded = part.set_in(loaded)
    except SelectionError as error:
        raise PlanError(f"{path}: {error}") from None
    whole, part = add_policies(loaded, part, path)
    if require_installed and whole.needs is not None:
        raise PlanError(needs_policy(path, part.policies))
    try:
        suite = part.apply_to(whole)
    except SelectionError as error:
        raise PlanError(f"{path}: {error}") from None
    fit, chosen = loaded.needs is not None, suite.tasks
    if fit:
        for entry in suite.policies:
            if (known := names.policies.get(entry.kind)) and known.tasks is not None:
                suite = of_tasks(suite, known.tasks.__contains__)
    if mistakes := check_names(suite, names):  # of added policies
        raise SuiteError([problem_at(path, None, message) for _, message in mistakes])
    environments = EnvironmentResolver(suite.environments)
    found = find_policies(suite, environments, start=start, ask=require_installed, fit=fit)
    suite = found.suite
    if require_installed:
        missing = [(name, f"policy '{name}': {reason}") for name, reason in found.unchecked.items()]
        found = replace(found, mistakes=[*missing, *found.mistakes])
    sources = found.sources
    unsupported = _unsupported_axes(suite)
    unsupported_tasks = Counter(gap.axis for gap in unsupported)
    refused = [
        gap
        for gap in unsupported
        if unsupported_tasks[gap.axis] == len(suite.tasks) or (suite.design and gap.axis in suite.design.axes)
    ]
    problems = [*_in_words(refused), *_missing_cameras(suite)]
    if problems or found.mistakes:
        whole_file = [problem_at(path, None, problem) for problem in problems]
        raise SuiteError([*found.problems(path, _text(path, text)), *whole_file])
    digests = {name: str(source.digest) for name, source in sources.items()}
    without = {(gap.axis, gap.task) for gap in unsupported}
    cells = tuple(
        cell
        for cell in (suite.cells(names, digests) if suite.needs is None else ())
        if not any((part.axis, cell.task) in without for part in cell.condition.perturbations)
    )
    suite_hash = UNKNOWN if suite.needs is None else NO_POLICY
    is_fitted = not (fit and found.unchecked)
    if suite.needs is None and is_fitted and all(source.digest for source in sources.values()):
        suite_hash = suite.content_hash(digests, names)
    simulator_names = dict.fromkeys(cell.simulator for cell in cells)
    return Plan(
        suite=suite,
        path=path,
        text=_text(path, text),
        suite_hash=suite_hash,
        cells=cells,
        sources=sources,
        unavailable=_unavailable_simulators(
            simulator_names, environments, only, require_one=require_installed, start=start
        ),
        unchecked=found.unchecked,
        unsupported=unsupported,
        left_out=tuple(task for task in chosen if task not in suite.tasks),
        notes=found.notes,
        warnings=(*found.warnings, *filter(None, [training_seeds(suite)])),
        server_metadata=found.server_metadata,
        environments=environments,
    )


def _text(path: Path, text: str | None) -> str:
    return path.read_text(encoding="utf-8") if text is None else text


def _unsupported_axes(suite: Suite) -> tuple[Unsupported, ...]:
    """Pairs of an axis of the suite and a task that does not support it."""
    cards = simulators.task_descriptions()
    axes = dict.fromkeys(axis for condition in suite.all_conditions() for axis in axes_of(condition))
    return tuple(
        Unsupported(axis=axis.name, task=task, reason=reason)
        for axis in axes
        for task in suite.tasks
        if (reason := why_unadjusted(axis, task) or why_unsupported(axis, cards[task].instruction))
    )


def _in_words(gaps: Iterable[Unsupported]) -> Iterator[str]:
    """A line for each axis and reason, with the first of its tasks."""
    tasks: dict[tuple[str, str], list[str]] = {}
    for gap in gaps:
        tasks.setdefault((gap.axis, gap.reason), []).append(gap.task)
    for (axis, reason), (first, *others) in tasks.items():
        more = f" and {counted(len(others), 'more task')}" if others else ""
        yield f"axis '{axis}' is unsupported in {first}{more}: {reason}"


def _missing_cameras(suite: Suite) -> Iterator[str]:
    """A line for each task that lacks a camera of the suite."""
    cards = simulators.task_descriptions()
    for task in suite.tasks:
        for camera in suite.cameras:
            if camera not in cards[task].cameras:
                yield f"task '{task}' has no camera '{camera}'; write cameras: [{', '.join(cards[task].cameras)}]"


def _unavailable_simulators(
    names: Collection[str],
    environments: EnvironmentResolver,
    required: Sequence[str],
    *,
    require_one: bool,
    start: bool,
) -> dict[str, str]:
    """The simulators that cannot run on this machine, each with the reason.

    Raises:
        PlanError: A required simulator is not in the suite or cannot run; with `require_one`, none can run.
    """
    reason_of = environments.missing_reason if start else environments.missing_file
    unavailable = {name: reason for name in names if (reason := reason_of(simulators.find(name)))}
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


def check_same(plan: Plan, document: RunDocument, folder: Path) -> None:
    """Refuse to continue a run with another suite or with changed policies, or one that was imported.

    Raises:
        PlanError: The plan differs from the run; the message says how.
    """
    if document.origin != "local":
        raise PlanError(
            f"{folder}: an imported run is not continued; play the suite in a folder of your own: --out NEW"
        )
    if plan.suite_hash == document.suite_hash:
        return
    if plan.suite_hash == UNKNOWN and plan.unchecked:
        raise PlanError(f"{folder}: its episodes are {UNKNOWN}, for which --check starts what the suite names")
    begun = {cell.policy: cell.policy_digest for cell in document.plan}
    changed = [name for name, source in plan.sources.items() if begun.get(name, source.digest) != source.digest]
    if document.suite.name != plan.suite.name:
        why = f"it holds a run of suite '{document.suite.name}', not '{plan.suite.name}'"
    elif changed:
        why = f"policy '{changed[0]}' has changed since the run was begun"
    else:
        why = f"suite '{plan.suite.name}' plans other episodes than when the run was begun"
    raise PlanError(f"{folder}: {why}; give another folder with --out")
