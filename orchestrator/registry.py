"""What this installation knows: its tasks, kinds of policies, axes and shipped suites. Starts nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path

from robogauntlet import suites
from robogauntlet.adapters import catalog as simulators
from robogauntlet.adapters.body import NO_METRES
from robogauntlet.adapters.scene_control import ADJUSTABLE
from robogauntlet.policies import catalog as policies
from robogauntlet.suites.axes import AXES, NO_VARIANT_NAME, VARIANT_NAME, axes_of
from robogauntlet.suites.axis import Axis
from robogauntlet.suites.episode import Condition
from robogauntlet.suites.loading import Problem, SuiteError
from robogauntlet.suites.paraphrases import why_unsupported
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.suites.registry import KnownPolicy, KnownTask, Registry

SHIPPED = Path(suites.__file__).parent


def find_suite(name: str) -> Path:
    """The path of a suite file, or of the shipped suite of that name, also beside a folder of that name.

    Raises:
        SuiteError: A name without a suffix that is neither.
    """
    path = Path(name)
    if path.suffix or path.is_file():
        return path
    shipped = {file.stem: file for file in SHIPPED.glob("*.yaml")}
    if name not in shipped and path.exists():
        return path
    if name not in shipped:
        files = {file.stem: str(file) for file in sorted(path.parent.glob("*.y*ml"))}
        near = get_close_matches(path.name, [*files, *shipped], n=1, cutoff=0.6)
        hint = did_you_mean(name, shipped, meant=[files.get(one, one) for one in near])
        raise SuiteError([Problem(name, None, f"no such file, and no shipped suite of that name{hint}")])
    return shipped[name]


class _DeclaredTasks(Mapping[str, KnownTask]):
    """The tasks of all simulators, each described when it is looked up: LIBERO-Plus has 10,030."""

    def __getitem__(self, task: str) -> KnownTask:
        description = simulators.task_descriptions()[task]
        declared = simulators.simulators()[task.partition("/")[0]]
        return KnownTask(description.horizon, declared.internal, description.robot, description.start_states)

    def __iter__(self) -> Iterator[str]:
        return iter(simulators.task_descriptions())

    def __len__(self) -> int:
        return len(simulators.task_descriptions())


def load_registry() -> Registry:
    """All tasks and policies that entry points declare, installed or not."""
    return Registry(
        tasks=_DeclaredTasks(),
        policies={
            kind.name: KnownPolicy(
                frozenset(kind.options),
                kind.tasks() if kind.tasks else None,
                bool(kind.requirements or kind.without_dependencies),
                kind.no_skill,
            )
            for kind in policies.kinds().values()
        },
        separate={kind: policies.INSTALL for kind in policies.SEPARATE if kind not in policies.kinds()},
        axes={axis.name: len(axis.levels) for axis in AXES.values()},
    )


def why_unadjusted(axis: Axis, task: str) -> str | None:
    """Why a task does not support an axis that changes the scene, or None."""
    part, simulator = str(axis.changes), simulators.find(task.partition("/")[0])
    if part in ADJUSTABLE and part not in simulator.adjusts:
        return f"{simulator.title} does not let its {part} be adjusted"
    description = simulators.task_descriptions()[task]
    if axis.name == VARIANT_NAME and not description.published_instruction:
        return NO_VARIANT_NAME
    if axis.name == "action-noise" and description.native:
        return NO_METRES
    return description.fixed.get(part)


def why_impossible(condition: Condition, task: str) -> str | None:
    """Why a task cannot have a condition, or None if it can."""
    if task not in simulators.task_descriptions():
        return "there is no such task in this installation"
    instruction = simulators.task_descriptions()[task].instruction
    reasons = (why_unadjusted(axis, task) or why_unsupported(axis.name, instruction) for axis in axes_of(condition))
    return next(filter(None, reasons), None)
