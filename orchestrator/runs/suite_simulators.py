"""The last step of a plan: what the simulators of a suite can do, and which of them this machine has."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

from robogauntlet.adapters import catalog as simulators
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.registry import why_unadjusted
from robogauntlet.orchestrator.runs.suite_names import PlanError
from robogauntlet.results.run_document import Unsupported
from robogauntlet.suites.axes import axes_of
from robogauntlet.suites.paraphrases import why_unsupported
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.schema import Suite
from robogauntlet.support.text import counted


@dataclass(frozen=True)
class SuiteSimulators:
    """The simulators of a suite."""

    unsupported: tuple[Unsupported, ...]
    """Axes that some tasks of the suite do not support; their cells are not planned."""
    mistakes: tuple[str, ...]
    """Messages on axes that no task supports and on cameras that a task lacks."""


def resolve_simulators(suite: Suite) -> SuiteSimulators:
    """Find what the tasks of a suite cannot do. Starts nothing."""
    unsupported = _unsupported_axes(suite)
    tasks = Counter(gap.axis for gap in unsupported)
    designed = suite.design.axes if suite.design else ()
    refused = (gap for gap in unsupported if tasks[gap.axis] == len(suite.tasks) or gap.axis in designed)
    return SuiteSimulators(unsupported, (*_in_words(refused), *_missing_cameras(suite)))


def _unsupported_axes(suite: Suite) -> tuple[Unsupported, ...]:
    """Pairs of an axis of the suite and a task that does not support it."""
    described = simulators.task_descriptions()
    axes = dict.fromkeys(axis for condition in suite.all_conditions() for axis in axes_of(condition))
    return tuple(
        Unsupported(axis=axis.name, task=task, reason=reason)
        for axis in axes
        for task in suite.tasks
        if (reason := why_unadjusted(axis, task) or why_unsupported(axis.name, described[task].instruction))
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
    described = simulators.task_descriptions()
    for task in suite.tasks:
        for camera in suite.cameras:
            if camera not in described[task].cameras:
                yield f"task '{task}' has no camera '{camera}'; write cameras: [{', '.join(described[task].cameras)}]"


def unavailable_simulators(
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
