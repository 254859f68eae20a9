"""`robogauntlet list`: list what can be named in a suite."""

from __future__ import annotations

from collections import Counter
from fnmatch import fnmatchcase
from typing import Annotated

import typer
from rich.table import Table

from robogauntlet.adapters import catalog as simulators
from robogauntlet.orchestrator.cli.common import AsJson, fail, out, print_json
from robogauntlet.orchestrator.cli.doctor import broken_plugins
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.runs.plan import SHIPPED
from robogauntlet.policies import catalog as policies
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput

Row = dict[str, str | int | bool]
MOST_LINES = 200
"""Tasks of a simulator that are listed one by one, unless a pattern asks for more."""


def list_names(
    task: Annotated[str | None, typer.Option(help="Only tasks that match this pattern, such as 'robosuite/*'.")] = None,
    as_json: AsJson = False,
) -> None:
    """List simulators, tasks, policies and shipped suites."""
    found = {"tasks": _tasks(task)}
    if task is None:
        found |= {"policies": _policies(), "suites": _suites()}
    if as_json:
        print_json(found)
    else:
        if task is None:
            found["tasks"] = _abbreviated(found["tasks"])
        for rows in found.values():
            out.print(_table(rows), "", sep="\n")
    for problem in broken_plugins():
        fail(problem)


def _tasks(pattern: str | None) -> list[Row]:
    environments, rows = EnvironmentResolver(), list[Row]()
    for simulator in simulators.simulators().values():
        if simulator.internal:
            continue
        installed = not environments.missing_reason(simulator)
        for name, task in simulator.tasks.items():
            row: Row = {"task": f"{simulator.name}/{name}", "instruction": task.instruction, "horizon": task.horizon}
            rows.append(row | {"simulator": simulator.title, "installed": installed})
    matching = [row for row in rows if pattern is None or fnmatchcase(str(row["task"]), pattern)]
    if not matching:
        raise BadInput(f"no task matches '{pattern}'{did_you_mean(str(pattern), [str(row['task']) for row in rows])}")
    return matching


def _abbreviated(rows: list[Row]) -> list[Row]:
    """One row for all tasks of a simulator that has many."""
    counts = Counter(row["simulator"] for row in rows)
    kept: dict[str, Row] = {}
    for row in rows:
        if counts[row["simulator"]] <= MOST_LINES:
            kept[str(row["task"])] = row
            continue
        name = f"{str(row['task']).partition('/')[0]}/*"
        said = f"{counts[row['simulator']]:,} tasks: robogauntlet list --task '{name}'"
        kept.setdefault(name, row | {"task": name, "instruction": said, "horizon": ""})
    return list(kept.values())


def _policies() -> list[Row]:
    return [{"policy": kind.name, "description": kind.summary} for kind in policies.kinds().values()]


def _suites() -> list[Row]:
    import yaml

    documents = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in sorted(SHIPPED.glob("*.yaml"))}
    return [
        {"suite": name, "description": document.get("description", "").strip()} for name, document in documents.items()
    ]


def _table(rows: list[Row]) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in rows[0]:
        table.add_column(column, no_wrap=column == "task")
    for row in rows:
        table.add_row(*(("no", "yes")[value] if isinstance(value, bool) else str(value) for value in row.values()))
    return table
