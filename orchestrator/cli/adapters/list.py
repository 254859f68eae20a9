"""`robogauntlet adapters list`: list the adapters of simulators."""

from __future__ import annotations

from rich.table import Table

from robogauntlet.adapters import catalog
from robogauntlet.adapters.contract import Simulator
from robogauntlet.adapters.scene_control import ADJUSTABLE
from robogauntlet.orchestrator.cli.common import fail, out, print_line
from robogauntlet.orchestrator.cli.doctor import broken_plugins
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.policies import oracles


def list_adapters() -> None:
    """List adapters with versions, tasks, the number of tasks with an oracle, and what perturbations can adjust."""
    table = Table("adapter", "simulator", "versions", "tasks", "oracles", "adjusts", box=None, pad_edge=False)
    environments = EnvironmentResolver()
    shown = [simulator for simulator in catalog.simulators().values() if not simulator.internal]
    for simulator in shown:
        solved = sum(f"{simulator.name}/{task}" in oracles.scripts() for task in simulator.tasks)
        counts = str(len(simulator.tasks)), str(solved)
        adjusts = "all" if simulator.adjusts >= ADJUSTABLE else ", ".join(sorted(simulator.adjusts)) or "nothing"
        table.add_row(simulator.name, simulator.title, _versions(environments, simulator), *counts, adjusts)
    out.print(table)
    for simulator in shown:
        if reason := environments.missing_reason(simulator):
            print_line(f"{simulator.name}: {reason}")
    for problem in broken_plugins():
        fail(problem)


def _versions(environments: EnvironmentResolver, simulator: Simulator) -> str:
    if environments.missing_reason(simulator):
        return "not installed"
    versions = environments.versions(simulator)
    return ", ".join(f"{name} {versions.get(name, '?')}" for name in simulator.distributions)
