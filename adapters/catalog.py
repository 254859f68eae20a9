"""Which simulators there are. Fed by entry points of the group `robogauntlet.simulators`; imports no simulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from importlib import metadata
from importlib.util import find_spec

from adapters.contract import AdapterError, Simulation, Simulator, SimulatorUnavailable, TaskCard, UnknownTask
from suites.vocabulary import View

GROUP = "robogauntlet.simulators"


@dataclass(frozen=True)
class BrokenPlugin:
    """An entry point that could not be loaded, or is not a `Simulator`."""

    name: str
    reason: str


@cache
def _load() -> tuple[Mapping[str, Simulator], tuple[BrokenPlugin, ...]]:
    simulators: dict[str, Simulator] = {}
    broken: list[BrokenPlugin] = []
    for entry in sorted(metadata.entry_points(group=GROUP), key=lambda e: e.name):
        try:
            simulator = entry.load()
        except Exception as error:  # a plug-in may fail in any way, and must not take the others along
            broken.append(BrokenPlugin(entry.name, f"{entry.value} cannot be loaded: {type(error).__name__}: {error}"))
            continue
        if not isinstance(simulator, Simulator):
            broken.append(
                BrokenPlugin(
                    entry.name,
                    f"{entry.value} is a {type(simulator).__name__}, expected an adapters.contract.Simulator",
                )
            )
        elif simulator.name != entry.name:
            broken.append(
                BrokenPlugin(
                    entry.name, f"{entry.value} calls itself '{simulator.name}', its entry point '{entry.name}'"
                )
            )
        else:
            simulators[entry.name] = simulator
    return simulators, tuple(broken)


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
        near = get_close_matches(simulator, known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"
        raise AdapterError(f"unknown simulator '{simulator}'; {hint}")
    return known[simulator]


def missing_reason(simulator: Simulator) -> str | None:
    """Why the simulator cannot be opened here, with the fix, or None if its modules are installed. Imports nothing."""
    missing = [module for module in simulator.modules if find_spec(module) is None]
    if missing:
        install = f"pip install -c constraints.txt -e '.[{simulator.name}]'"
        return f"not installed (no module {missing[0]}); install it: {install}"
    return None


def open_simulation(task: str, view: View) -> Simulation:
    """Open `simulator/task` in this process.

    Raises:
        SimulatorUnavailable: Not installed, or cannot render here.
        UnknownTask: No such task.
    """
    name, _, short = task.partition("/")
    simulator = find(name)
    if short not in simulator.tasks:
        near = get_close_matches(short, simulator.tasks, n=1)
        hint = f"did you mean '{name}/{near[0]}'?" if near else f"known: {', '.join(simulator.tasks)}"
        raise UnknownTask(f"unknown task '{task}'; {hint}")
    reason = missing_reason(simulator)
    if reason:
        raise SimulatorUnavailable(f"{name}: {reason}")
    return simulator.open(short, view)
