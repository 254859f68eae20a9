"""Scripts that other packages bring for their simulators: entry points of the group `robogauntlet.oracles`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module, metadata
from types import ModuleType

from robogauntlet.policies.oracles.motion import Script
from robogauntlet.suites.plugins import BrokenPlugin

GROUP = "robogauntlet.oracles"


@dataclass(frozen=True)
class OraclePlugin:
    """What an entry point holds: a mapping such as `{"mysim/Reach": Reach}`, under the name `mysim`."""

    name: str
    """Of the simulator. An entry point speaks for its own only, so no package replaces the oracle of another."""
    scripts: Mapping[str, Callable[[], Script]]
    """Full task name, `simulator/task`, to what makes the script of one episode."""
    module: str
    """That holds the mapping."""

    def modules(self) -> list[ModuleType]:
        """The modules in which the scripts are written: their source is part of what the oracle is."""
        names = {self.module} | {getattr(_unwrapped(made), "__module__", self.module) for made in self.scripts.values()}
        return [import_module(name) for name in sorted(names)]


def _unwrapped(made: Callable[..., object]) -> Callable[..., object]:
    """What a partial call is of: the partial itself is written in Python's library, another in each version."""
    return _unwrapped(made.func) if isinstance(made, partial) else made


@cache
def load_oracles() -> tuple[Mapping[str, OraclePlugin], tuple[BrokenPlugin, ...]]:
    """The scripts of each entry point, by simulator, and the entry points that are broken."""
    found: dict[str, OraclePlugin] = {}
    broken: list[BrokenPlugin] = []
    for entry in sorted(metadata.entry_points(group=GROUP), key=lambda e: (e.name, e.value)):
        try:
            scripts = entry.load()
        except Exception as error:  # a plug-in may fail in any way, and must not take the others along
            problem: str | None = f"cannot be loaded: {type(error).__name__}: {error}"
        else:
            problem = _problem(entry.name, scripts, found)
        if problem:
            broken.append(BrokenPlugin(entry.name, f"{entry.value} {problem}"))
        else:
            found[entry.name] = OraclePlugin(entry.name, dict(scripts), entry.module)
    return found, tuple(broken)


def _problem(simulator: str, scripts: object, taken: Collection[str]) -> str | None:
    """What is wrong with the scripts of an entry point, or None."""
    if simulator in taken:
        return f"is the second entry point named '{simulator}' in {GROUP}; remove one"
    if not isinstance(scripts, Mapping):
        return f"is a {type(scripts).__name__}, expected a mapping of '{simulator}/TASK' to what makes a script"
    for task, script in scripts.items():
        if not str(task).startswith(f"{simulator}/"):
            return f"has a script for '{task}', expected tasks of its own simulator such as '{simulator}/TASK'"
        if not callable(script):
            return f"has a {type(script).__name__} for '{task}', expected what makes a script when it is called"
    return None
