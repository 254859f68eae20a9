"""`robogauntlet list`: list what can be named in a suite."""

from __future__ import annotations

from rich.table import Table

from robogauntlet.adapters import catalog as simulators
from robogauntlet.orchestrator.cli.common import fail, out
from robogauntlet.orchestrator.cli.doctor import broken_plugins
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.runs.plan import SHIPPED
from robogauntlet.policies import catalog as policies


def list_names() -> None:
    """List simulators, tasks, policies and shipped suites."""
    import yaml

    tasks = Table(box=None, pad_edge=False)
    tasks.add_column("task", no_wrap=True)
    for column in ("instruction", "horizon", "simulator"):
        tasks.add_column(column)
    environments = EnvironmentResolver()
    for simulator in simulators.simulators().values():
        if simulator.internal:
            continue
        state = "not installed" if environments.missing_reason(simulator) else simulator.title
        for name, task in simulator.tasks.items():
            tasks.add_row(f"{simulator.name}/{name}", task.instruction, str(task.horizon), state)
    kinds = Table("policy", "description", box=None, pad_edge=False)
    for kind in policies.kinds().values():
        kinds.add_row(kind.name, kind.summary)
    suites = Table("suite", "description", box=None, pad_edge=False)
    for path in sorted(SHIPPED.glob("*.yaml")):
        suites.add_row(path.stem, yaml.safe_load(path.read_text(encoding="utf-8")).get("description", "").strip())
    out.print(tasks, "", kinds, "", suites, sep="\n")
    for problem in broken_plugins():
        fail(problem)
