"""Turns a suite file into a plan, and determines its remaining work. Starts and writes nothing."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.policy_source import PolicySource
from robogauntlet.orchestrator.registry import load_registry
from robogauntlet.orchestrator.runs.adaptive_stopping import Outcomes, Progression, Work, key_of, progression
from robogauntlet.orchestrator.runs.suite_names import PlanError, resolve_names
from robogauntlet.orchestrator.runs.suite_policies import SuitePolicies, resolve_policies
from robogauntlet.orchestrator.runs.suite_simulators import resolve_simulators, unavailable_simulators
from robogauntlet.results.run_document import PlannedCell, RunDocument, Unsupported, refuse_imported
from robogauntlet.suites.checks import training_seeds
from robogauntlet.suites.episode import Cell
from robogauntlet.suites.loading import SuiteError, problem_at
from robogauntlet.suites.registry import Registry
from robogauntlet.suites.schema import Suite
from robogauntlet.suites.selection import SuiteSelection
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
    named = resolve_names(path, text, part, names, require_policy=require_installed)
    environments = EnvironmentResolver(named.suite.environments)
    found = resolve_policies(named.suite, environments, start=start, required=require_installed, fit=named.is_open)
    suite = found.suite
    scene = resolve_simulators(suite)
    if scene.mistakes or found.mistakes:
        whole_file = [problem_at(path, None, mistake) for mistake in scene.mistakes]
        raise SuiteError([*found.problems(path, _text(path, text)), *whole_file])
    cells, suite_hash = _identified(suite, found, scene.unsupported, names, is_open=named.is_open)
    used = dict.fromkeys(cell.simulator for cell in cells)
    return Plan(
        suite=suite,
        path=path,
        text=_text(path, text),
        suite_hash=suite_hash,
        cells=cells,
        sources=found.sources,
        unavailable=unavailable_simulators(used, environments, only, require_one=require_installed, start=start),
        unchecked=found.unchecked,
        unsupported=scene.unsupported,
        left_out=tuple(task for task in named.tasks if task not in suite.tasks),
        notes=found.notes,
        warnings=(*found.warnings, *filter(None, [training_seeds(suite)])),
        server_metadata=found.server_metadata,
        environments=environments,
    )


def _identified(
    suite: Suite, found: SuitePolicies, gaps: Sequence[Unsupported], names: Registry, *, is_open: bool
) -> tuple[tuple[Cell, ...], str]:
    """The cells of a suite without those that a task does not support, and the hash of the suite."""
    if suite.needs is not None:
        return (), NO_POLICY
    digests = {name: str(source.digest) for name, source in found.sources.items()}
    without = {(gap.axis, gap.task) for gap in gaps}
    cells = tuple(
        cell
        for cell in suite.cells(names, digests)
        if not any((part.axis, cell.task) in without for part in cell.condition.perturbations)
    )
    if (is_open and found.unchecked) or not all(source.digest for source in found.sources.values()):
        return cells, UNKNOWN
    return cells, suite.content_hash(digests, names)


def _text(path: Path, text: str | None) -> str:
    return path.read_text(encoding="utf-8") if text is None else text


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
        RunError: The run was imported.
    """
    refuse_imported(folder, document, "continued")
    if plan.suite_hash == document.suite_hash:
        return
    if plan.suite_hash == UNKNOWN and plan.unchecked:
        raise PlanError(f"{folder}: its episodes are {UNKNOWN}, for which --start starts what the suite names")
    begun = {cell.policy: cell.policy_digest for cell in document.plan}
    changed = [name for name, source in plan.sources.items() if begun.get(name, source.digest) != source.digest]
    if document.suite.name != plan.suite.name:
        why = f"it holds a run of suite '{document.suite.name}', not '{plan.suite.name}'"
    elif changed:
        why = f"policy '{changed[0]}' has changed since the run was begun"
    else:
        why = f"suite '{plan.suite.name}' plans other episodes than when the run was begun"
    raise PlanError(f"{folder}: {why}; give another folder with --out")
