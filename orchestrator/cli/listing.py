"""`gauntlet list`: what there is."""

from __future__ import annotations

from rich.table import Table

from adapters import catalog as simulators
from orchestrator.cli.shared import fail, homes_here, out
from orchestrator.plan import SHIPPED
from policies import catalog as policies
from policies import oracles


def list_names() -> None:
    """List simulators, tasks, policies and shipped suites."""
    tasks = Table(box=None, pad_edge=False)
    tasks.add_column("task", no_wrap=True)
    for column in ("instruction", "horizon", "simulator"):
        tasks.add_column(column)
    homes = homes_here()
    for simulator in simulators.simulators().values():
        if simulator.internal:
            continue
        state = "not installed" if homes.missing_reason(simulator) else simulator.title
        for name, card in simulator.tasks.items():
            tasks.add_row(f"{simulator.name}/{name}", card.instruction, str(card.horizon), state)
    out.print(tasks)
    kinds = Table("policy", "what it does", box=None, pad_edge=False)
    for kind in policies.kinds().values():
        kinds.add_row(kind.name, kind.summary)
    out.print()
    out.print(kinds)
    suites = Table("suite", "what it is for", box=None, pad_edge=False)
    for path in sorted(SHIPPED.glob("*.yaml")):
        suites.add_row(path.stem, _description(path.read_text(encoding="utf-8")))
    out.print()
    out.print(suites)
    for plugin in simulators.broken_plugins():
        fail(f"simulator {plugin.name}: {plugin.reason}")
    for plugin in policies.broken_plugins():
        fail(f"policy {plugin.name}: {plugin.reason}")
    for plugin in oracles.broken_plugins():
        fail(f"oracle {plugin.name}: {plugin.reason}")


def _description(text: str) -> str:
    import yaml

    return str(yaml.safe_load(text).get("description", "")).strip()
