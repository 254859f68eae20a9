"""Oracle scripts of other packages for their simulators: entry points of the group `robogauntlet.oracles`."""

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
    """The content of an entry point: a mapping such as `{"mysim/Reach": Reach}`, under the name `mysim`."""

    name: str
    """Name of the simulator. An entry point has scripts for this one only, so no package replaces another's oracle."""
    scripts: Mapping[str, Callable[[], Script]]
    """Full task name, `simulator/task`, to a callable that builds the script of one episode."""
    module: str
    """Name of the module with the mapping."""
    shared: tuple[str, ...] = ()
    """Names of other modules from which the scripts import."""

    def modules(self) -> list[ModuleType]:
        """Return the modules of the scripts, and `shared`; the oracle's digest covers their source."""
        names = {self.module, *self.shared} | {
            getattr(_unwrap(build), "__module__", self.module) for build in self.scripts.values()
        }
        return [import_module(name) for name in sorted(names)]


def _unwrap(build: Callable[..., object]) -> Callable[..., object]:
    """Return the function of a partial call, which is itself defined in Python's library."""
    return _unwrap(build.func) if isinstance(build, partial) else build


@cache
def load_oracles() -> tuple[Mapping[str, OraclePlugin], tuple[BrokenPlugin, ...]]:
    """Return the scripts of each entry point, by simulator, and the broken entry points."""
    plugins: dict[str, OraclePlugin] = {}
    broken: list[BrokenPlugin] = []
    for entry in sorted(metadata.entry_points(group=GROUP), key=lambda e: (e.name, e.value)):
        try:
            scripts = entry.load()
        except Exception as error:  # a plug-in may fail in any way, without effect on others
            problem: str | None = f"cannot be loaded: {type(error).__name__}: {error}"
        else:
            problem = _problem(entry.name, scripts, plugins)
        if problem:
            broken.append(BrokenPlugin(entry.name, f"{entry.value} {problem}"))
        else:
            plugins[entry.name] = OraclePlugin(entry.name, dict(scripts), entry.module)
    return plugins, tuple(broken)


def _problem(simulator: str, scripts: object, taken: Collection[str]) -> str | None:
    """Describe the error in the scripts of an entry point, or return None."""
    if simulator in taken:
        return f"is the second entry point named '{simulator}' in {GROUP}; remove one"
    if not isinstance(scripts, Mapping):
        return (
            f"is a {type(scripts).__name__}, expected a mapping of '{simulator}/TASK' to callables that build a script"
        )
    for task, script in scripts.items():
        if not str(task).startswith(f"{simulator}/"):
            return f"has a script for '{task}', expected tasks of its own simulator such as '{simulator}/TASK'"
        if not callable(script):
            return f"has a {type(script).__name__} for '{task}', expected a callable that builds a script"
    return None
