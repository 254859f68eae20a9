"""`gauntlet adapters list`: which simulators there are, and what of their worlds can be adjusted."""

from __future__ import annotations

from rich.table import Table

from adapters import catalog
from adapters.adjusting import ADJUSTABLE
from adapters.contract import Simulator
from orchestrator.cli.shared import fail, homes_here, out
from orchestrator.environments.homes import Homes
from policies import oracles


def list_adapters() -> None:
    """List adapters: versions, tasks, how many of them an oracle solves, and what perturbations may adjust."""
    table = Table("adapter", "simulator", "versions", "tasks", "oracles", "adjusts", box=None, pad_edge=False)
    homes = homes_here()
    shown = [simulator for simulator in catalog.simulators().values() if not simulator.internal]
    for simulator in shown:
        solved = sum(f"{simulator.name}/{task}" in oracles.scripts() for task in simulator.tasks)
        counts = str(len(simulator.tasks)), str(solved)
        table.add_row(simulator.name, simulator.title, _versions(homes, simulator), *counts, _adjusts(simulator))
    out.print(table)
    for simulator in shown:
        if reason := homes.missing_reason(simulator):
            out.print(f"{simulator.name}: {reason}", markup=False, soft_wrap=True)
    for plugin in catalog.broken_plugins():
        fail(f"simulator {plugin.name}: {plugin.reason}")
    for plugin in oracles.broken_plugins():
        fail(f"oracle {plugin.name}: {plugin.reason}")


def _versions(homes: Homes, simulator: Simulator) -> str:
    if homes.missing_reason(simulator):
        return "not installed"
    versions = homes.versions(simulator)
    return ", ".join(f"{name} {versions.get(name, '?')}" for name in simulator.distributions)


def _adjusts(simulator: Simulator) -> str:
    if simulator.adjusts >= ADJUSTABLE:
        return "all"
    return ", ".join(sorted(simulator.adjusts)) or "nothing"
