"""Which simulators there are. Fed by entry points of the group `robogauntlet.simulators`; imports no simulator."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec

from adapters.batch import SeparateSimulations
from adapters.contract import (
    AdapterError,
    Simulation,
    SimulationBatch,
    Simulator,
    SimulatorUnavailable,
    TaskCard,
    UnknownTask,
)
from suites.plugins import BrokenPlugin, load_plugins, nearest
from suites.vocabulary import View

GROUP = "robogauntlet.simulators"


@cache
def _load() -> tuple[Mapping[str, Simulator], tuple[BrokenPlugin, ...]]:
    return load_plugins(GROUP, Simulator)


def simulators() -> Mapping[str, Simulator]:
    """Every declared simulator by name, installed or not."""
    return _load()[0]


def broken_plugins() -> tuple[BrokenPlugin, ...]:
    """Entry points that declare no usable simulator."""
    return _load()[1]


def task_cards() -> dict[str, TaskCard]:
    """Every task of every simulator, `simulator/task` to its card."""
    return {f"{s.name}/{task}": card for s in simulators().values() for task, card in s.tasks.items()}


def find(simulator: str) -> Simulator:
    """The simulator of that name.

    Raises:
        AdapterError: There is none.
    """
    known = simulators()
    if simulator not in known:
        shown = (name for name, one in known.items() if not one.internal)
        raise AdapterError(f"unknown simulator '{simulator}'{nearest(simulator, shown)}")
    return known[simulator]


def missing_reason(simulator: Simulator) -> str | None:
    """Why the simulator cannot be opened in this process, with the fix, or None if its modules are installed.

    Imports nothing. Where the process is not the one that opens it, ask `orchestrator.environments`.
    """
    missing = [module for module in simulator.modules if find_spec(module) is None]
    if missing:
        own = simulator.requirements or simulator.without_dependencies
        by_pip = f"pip install -c constraints.txt -e '.[{simulator.name}]'"
        install = f"gauntlet env create {simulator.name}" if own else by_pip
        return f"not installed (no module {missing[0]}); install it: {install}"
    return None


def open_simulation(task: str, view: View) -> Simulation:
    """Open `simulator/task` in this process.

    Raises:
        SimulatorUnavailable: Not installed, or cannot render here.
        UnknownTask: No such task.
    """
    simulator, short = _found(task)
    return simulator.open(short, view)


def open_batch(task: str, view: View, count: int) -> SimulationBatch:
    """Open `simulator/task` so often in this process, with one engine for all if the simulator has such.

    Raises:
        SimulatorUnavailable: Not installed, or cannot render here.
        UnknownTask: No such task.
    """
    simulator, short = _found(task)
    if count > 1 and simulator.open_batch is not None:
        return simulator.open_batch(short, view, count)
    return SeparateSimulations([simulator.open(short, view) for _ in range(count)])


def _found(task: str) -> tuple[Simulator, str]:
    """A task's simulator and its name there."""
    name, _, short = task.partition("/")
    simulator = find(name)
    if short not in simulator.tasks:
        raise UnknownTask(f"unknown task '{task}'{nearest(task, (f'{name}/{t}' for t in simulator.tasks))}")
    reason = missing_reason(simulator)
    if reason:
        raise SimulatorUnavailable(f"{name}: {reason}")
    return simulator, short
