"""The simulators that entry points of the group `robogauntlet.simulators` declare. Imports no simulator."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, metadata
from importlib.util import find_spec

from robogauntlet.adapters.contract import (
    ActionSpec,
    AdapterError,
    Body,
    Goal,
    Joint,
    Number,
    Simulation,
    Simulator,
    SimulatorUnavailable,
    TaskDescription,
    UnknownTask,
)
from robogauntlet.suites.episode import View
from robogauntlet.suites.plugins import BrokenPlugin, Plugins, did_you_mean

GROUP = "robogauntlet.simulators"


@cache
def _load() -> Plugins[Simulator]:
    return Plugins(GROUP, Simulator)


def simulators() -> Mapping[str, Simulator]:
    """Return every declared simulator by name, installed or not."""
    return _load()


def broken_plugins() -> tuple[BrokenPlugin, ...]:
    """Return the entry points that cannot be used."""
    return _load().broken


class _TaskDescriptions(Mapping[str, TaskDescription]):
    """All tasks, looked up one by one: a simulator can have ten thousand."""

    def __getitem__(self, task: str) -> TaskDescription:
        name, _, short = task.partition("/")
        return simulators()[name].tasks[short]

    def __iter__(self) -> Iterator[str]:
        return (f"{simulator.name}/{name}" for simulator in simulators().values() for name in simulator.tasks)

    def __len__(self) -> int:
        return sum(len(simulator.tasks) for simulator in simulators().values())


def task_descriptions() -> Mapping[str, TaskDescription]:
    """Return the descriptions of all tasks by `simulator/task`."""
    return _TaskDescriptions()


def original(task: str) -> str:
    """Return the task (`simulator/task`) of which a task is a variant, or the task itself, known or not."""
    description = task_descriptions().get(task)
    return description.variant_of if description and description.variant_of else task


def goal_of(task: str) -> Goal | None:
    """Return what `simulator/task` declares as its goal, if there is such a task and it does."""
    description = task_descriptions().get(task)
    return description.goal if description else None


def body_of(task: str) -> Body:
    """Return what acts in `simulator/task`; an arm whose tool is moved if there is no such task."""
    description = task_descriptions().get(task)
    return description.body if description else Body()


def stand_in_spec(task: str) -> ActionSpec:
    """Return an action's numbers in `simulator/task`, with bounds of 1, where the task is not open."""
    body = body_of(task)
    joints = tuple(Joint(name, -1.0, 1.0, 1.0) for name in body.joints)
    numbers = tuple(Number(name, -1.0, 1.0) for name in body.native)
    return ActionSpec(1.0, 1.0, 1.0, (), body.arms, joints, body.velocities, numbers, body.state)


def find(simulator: str) -> Simulator:
    """Return the simulator of that name.

    Raises:
        AdapterError: It does not exist.
    """
    known = simulators()
    if simulator not in known:
        public = (name for name, declared in known.items() if not declared.internal)
        raise AdapterError(f"unknown simulator '{simulator}'{did_you_mean(simulator, public)}")
    return known[simulator]


def missing_reason(simulator: Simulator) -> str | None:
    """Return why the simulator cannot be opened in this process and what to do.

    None if its modules are installed, and those of one of its tasks. Imports nothing. For other processes, use
    `robogauntlet.orchestrator.environments`.
    """
    missing = _missing(simulator.modules)
    if not missing and installed_task(simulator) is None:
        missing = _missing(module for task in simulator.tasks.values() for module in task.modules)
    if not missing:
        return None
    remedy = "install the package that provides it"
    if simulator.requirements or simulator.without_dependencies:
        remedy = f"install it: robogauntlet env create {simulator.name}"
    elif simulator.name in _extras():
        remedy = f'install it: pip install "robogauntlet[{simulator.name}]"'
    elif simulator.distributions:
        remedy = f"install it: pip install {' '.join(simulator.distributions)}"
    newest = simulator.newest_python
    if newest and sys.version_info[:2] > tuple(map(int, newest.split("."))):
        remedy += f", with Python {newest}, the newest for which its packages have wheels"
    return f"not installed (no module {missing[0]}); {remedy}"


def installed_task(simulator: Simulator) -> str | None:
    """Return the simulator's first task whose own modules are installed, or None. Imports nothing."""
    return next((name for name, task in simulator.tasks.items() if not _missing(task.modules)), None)


def _missing(modules: Iterable[str]) -> list[str]:
    return [module for module in modules if find_spec(module) is None]


def _extras() -> list[str]:
    """Names of RoboGauntlet's extras; none where it is on the path without being installed."""
    try:
        return metadata("robogauntlet").get_all("Provides-Extra") or []
    except PackageNotFoundError:
        return []


def open_simulation(task: str, view: View) -> Simulation:
    """Open `simulator/task` in this process.

    Raises:
        SimulatorUnavailable: Not installed, or cannot render here.
        UnknownTask: No such task.
    """
    name, _, short = task.partition("/")
    simulator = find(name)
    if short not in simulator.tasks:
        raise UnknownTask(f"unknown task '{task}'{did_you_mean(task, (f'{name}/{t}' for t in simulator.tasks))}")
    reason = missing_reason(simulator)
    if reason:
        raise SimulatorUnavailable(f"{name}: {reason}")
    return simulator.open(short, view)
