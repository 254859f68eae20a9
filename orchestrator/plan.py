"""From a suite file to the work that is still to be done. Nothing is started or written here."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from adapters import catalog as simulators
from adapters.adjusting import ADJUSTABLE
from adapters.contract import ActionSpec, ObservationSpec
from orchestrator.environments.homes import Homes
from orchestrator.names import known_names
from orchestrator.sources import PolicySource
from policies import catalog as policies
from policies.contract import PolicyError, PolicyMismatch, check_fit
from results.run import PlannedCell, RunDocument, Unsupported
from suites.axes import Axis, axis_of, why_unsupported
from suites.loading import Problem, SuiteError, load_suite
from suites.part import NoSuchPart, Part
from suites.plugins import nearest
from suites.schema import Suite
from suites.vocabulary import Cell

SHIPPED = Path(__file__).parent.parent / "suites"
WHOLE = Part()
Done = Mapping[tuple[str, str, str, int], Collection[int]]
"""Seeds that have a row, by policy digest, task, axis and severity."""


class PlanError(Exception):
    """A suite that cannot be run as asked; one line per problem."""


@dataclass(frozen=True)
class Plan:
    """A validated suite with everything resolved."""

    suite: Suite
    path: Path
    text: str
    """The suite file, word for word."""
    suite_hash: str
    cells: tuple[Cell, ...]
    sources: Mapping[str, PolicySource]
    digests: Mapping[str, str]
    """Policy name to the hash of its content."""
    unavailable: Mapping[str, str]
    """Simulator of the suite that is not installed, or whose environment does not fit, to the reason."""
    unsupported: tuple[Unsupported, ...] = ()
    """Axes that some tasks of the suite cannot have; those cells are not planned."""
    homes: Homes = field(default_factory=Homes, compare=False)
    """In which environment each simulator runs."""

    @property
    def simulators(self) -> list[str]:
        """Simulators that the suite names, in its order."""
        return list(dict.fromkeys(cell.simulator for cell in self.cells))

    @property
    def episodes(self) -> int:
        """Episodes planned."""
        return len(self.cells) * self.suite.seeds.count

    def planned_cells(self, seeds: Mapping[Cell, int] | None = None) -> tuple[PlannedCell, ...]:
        """The plan as the run document holds it.

        Args:
            seeds: How many are planned of each cell, if not those of the suite.
        """
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

    def missing(self, done: Done) -> list[tuple[Cell, Sequence[int]]]:
        """Cells with the seeds that have no row yet, without those of simulators that cannot run here."""
        work: list[tuple[Cell, Sequence[int]]] = []
        for cell in self.cells:
            if cell.simulator in self.unavailable:
                continue
            there = done.get((cell.policy_digest, cell.task, cell.condition.axis, cell.condition.severity), ())
            seeds = array("q", (seed for seed in self.suite.seeds if seed not in there))
            if seeds:
                work.append((cell, seeds))
        return work


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
        message = f"no such file, and no shipped suite of that name{nearest(name, shipped)}"
        raise SuiteError([Problem(name, None, message)])
    return shipped[name]


def make_plan(path: Path, *, part: Part = WHOLE, only: Sequence[str] = ()) -> Plan:
    """Read, validate and resolve a suite.

    Args:
        path: The suite file.
        part: What of it to plan.
        only: Simulators that must work; empty for none.

    Raises:
        SuiteError: The file is wrong.
        PlanError: The suite is right, and cannot be run as asked.
    """
    names = known_names()
    try:
        suite = part.of(load_suite(path, names))
    except NoSuchPart as error:
        raise PlanError(f"{path}: {error}") from None
    text = path.read_text(encoding="utf-8")
    sources, digests, homes = {}, {}, Homes(suite.environments)
    problems: list[str] = []
    by_digest: dict[str, str] = {}
    for entry in suite.policies:
        try:
            options = homes.options(entry.kind, entry.options)
            digest = policies.digest(entry.kind, options)
            spec = policies.spec(entry.kind, options)
            check_fit(spec, ActionSpec(1.0, 1.0, 1.0), ObservationSpec(suite.cameras, suite.image_size))
        except PolicyMismatch as error:
            problems.append(f"policy '{entry.name}' does not fit: {error}")
            continue
        except PolicyError as error:
            problems.append(f"policy '{entry.name}': {error}")
            continue
        if digest in by_digest:
            problems.append(f"policies '{by_digest[digest]}' and '{entry.name}' are the same policy; remove one")
        by_digest.setdefault(digest, entry.name)
        digests[entry.name] = digest
        sources[entry.name] = PolicySource(entry.kind, options, digest)
    unsupported = _unsupported(suite)
    problems += _nowhere(suite, unsupported) + _unseen(suite)
    if problems:
        raise SuiteError([Problem(str(path), None, problem) for problem in problems])
    without = {(gap.axis, gap.task) for gap in unsupported}
    cells = tuple(cell for cell in suite.cells(names, digests) if (cell.condition.axis, cell.task) not in without)
    plan = Plan(suite, path, text, suite.content_hash(digests, names), cells, sources, digests, {}, unsupported, homes)
    unavailable = {name: reason for name in plan.simulators if (reason := homes.missing_reason(simulators.find(name)))}
    required = [f"{name}: {unavailable[name]}" for name in only if name in unavailable]
    unknown = [
        f"{name}: the suite does not use this simulator{nearest(name, plan.simulators)}"
        for name in only
        if name not in plan.simulators
    ]
    if required or unknown:
        raise PlanError("\n".join([*unknown, *required]))
    if len(unavailable) == len(plan.simulators):
        raise PlanError("\n".join(f"{name}: {reason}" for name, reason in unavailable.items()))
    return replace(plan, unavailable=unavailable)


def _unsupported(suite: Suite) -> tuple[Unsupported, ...]:
    """The axes that cannot be brought about in a task of the suite."""
    cards = simulators.task_cards()
    axes = dict.fromkeys(filter(None, map(axis_of, suite.all_conditions())))
    return tuple(
        Unsupported(axis=axis.name, task=task, reason=reason)
        for axis in axes
        for task in suite.tasks
        if (reason := why_unadjusted(axis, task) or why_unsupported(axis, cards[task].instruction))
    )


def _nowhere(suite: Suite, unsupported: Sequence[Unsupported]) -> list[str]:
    """A line for each task of an axis that no task of the suite can have."""
    tasks = Counter(gap.axis for gap in unsupported)
    return [
        f"axis '{gap.axis}' is unsupported in {gap.task}: {gap.reason}"
        for gap in unsupported
        if tasks[gap.axis] == len(suite.tasks)
    ]


def _unseen(suite: Suite) -> list[str]:
    """A line for each task that lacks a camera of the suite."""
    cards = simulators.task_cards()
    return [
        f"task '{task}' has no camera '{camera}'; write cameras: [{', '.join(cards[task].cameras)}]"
        for task in suite.tasks
        for camera in suite.cameras
        if camera not in cards[task].cameras
    ]


def why_unadjusted(axis: Axis, task: str) -> str | None:
    """Why an axis of the world cannot be brought about in a task, or None."""
    part, simulator = str(axis.changes), simulators.find(task.partition("/")[0])
    if part in ADJUSTABLE and part not in simulator.adjusts:
        return f"{simulator.title} does not let its {part} be adjusted"
    return simulators.task_cards()[task].fixed.get(part)


def check_same(plan: Plan, document: RunDocument, folder: Path) -> None:
    """Refuse to continue a run with another suite or with policies that have changed.

    Raises:
        PlanError: With what differs.
    """
    if plan.suite_hash == document.suite_hash:
        return
    begun = {cell.policy: cell.policy_digest for cell in document.plan}
    changed = [name for name, digest in plan.digests.items() if name in begun and begun[name] != digest]
    if document.suite_name != plan.suite.name:
        why = f"it holds a run of suite '{document.suite_name}', not '{plan.suite.name}'"
    elif changed:
        why = f"policy '{changed[0]}' has changed since the run was begun"
    else:
        why = f"suite '{plan.suite.name}' plans other episodes than when the run was begun"
    raise PlanError(f"{folder}: {why}; give another folder with --out")
