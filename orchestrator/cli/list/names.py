"""`robogauntlet list simulators`, `tasks`, `policies` and `suites`: list what can be named in a suite."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from robogauntlet.adapters import catalog as simulators
from robogauntlet.adapters.package_files import looking_in
from robogauntlet.adapters.scene_control import ADJUSTABLE
from robogauntlet.orchestrator.cli.check.installation import broken_plugins
from robogauntlet.orchestrator.cli.common import AsJson, fail, out, print_json, print_line
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.registry import SHIPPED
from robogauntlet.policies import catalog as policies, oracles
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.errors import BadInput
from robogauntlet.support.text import visible

Row = dict[str, str | int | bool]
MOST_LINES = 200
"""Tasks of a simulator that are listed one by one, unless a pattern asks for more; and episodes of a run."""


def list_simulators(as_json: AsJson = False) -> None:
    """List the simulators with their versions and numbers of tasks."""
    environments, rows, missing = EnvironmentResolver(), list[Row](), dict[str, str]()
    for one in simulators.simulators().values():
        if one.internal:
            continue
        if reason := environments.missing_reason(one):
            missing[one.name] = reason
        versions = {} if reason else environments.versions(one)
        named = ", ".join(f"{name} {versions.get(name, '?')}" for name in one.distributions)
        row: Row = {"simulator": one.name, "title": one.title, "versions": "not installed" if reason else named}
        solved = sum(f"{one.name}/{task}" in oracles.scripts() for task in one.tasks)
        adjusts = "all" if one.adjusts >= ADJUSTABLE else ", ".join(sorted(one.adjusts)) or "nothing"
        row |= {"tasks": len(one.tasks), "oracles": solved, "adjusts": adjusts}
        rows.append(row | ({"installed": not reason} if as_json else {}))
    _show("simulators", rows, as_json=as_json)
    if not as_json:
        for name, reason in missing.items():
            print_line(f"{name}: {reason}")


def list_tasks(
    patterns: Annotated[
        list[str] | None,
        typer.Argument(metavar="TASKS", help="Only this task, or tasks that match a pattern, such as 'robosuite/*'."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the tasks of all simulators with their instructions."""
    rows = _tasks(patterns or ())
    _show("tasks", rows if patterns or as_json else _abbreviated(rows), as_json=as_json)


def list_policies(as_json: AsJson = False) -> None:
    """List the kinds of policies, with the addresses of servers."""
    rows: list[Row] = [
        {"policy": kind.name, "address": kind.address, "description": kind.summary, "needs": kind.needs}
        for kind in policies.kinds().values()
    ]
    _show("policies", rows, as_json=as_json)


def list_suites(as_json: AsJson = False) -> None:
    """List the suites that are shipped."""
    import yaml

    documents = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in sorted(SHIPPED.glob("*.yaml"))}
    rows: list[Row] = [
        {"suite": name, "description": document.get("description", "").strip()} for name, document in documents.items()
    ]
    _show("suites", rows, as_json=as_json)


def _show(what: str, rows: list[Row], *, as_json: bool) -> None:
    """Print rows as a table or as JSON, and the plugins that cannot be loaded."""
    if as_json:
        print_json({what: rows})
    else:
        print_rows(rows)
    for problem in broken_plugins():
        fail(problem)


def print_rows(rows: Sequence[Row]) -> None:
    """Print rows as a table with their names as its header."""
    table = Table(box=None, pad_edge=False)
    for column in rows[0]:
        table.add_column(column, no_wrap=column in ("task", "episode"))
    for row in rows:
        cells = (("no", "yes")[value] if isinstance(value, bool) else str(value) for value in row.values())
        table.add_row(*(Text(visible(cell)) for cell in cells))
    out.print(table)


def _tasks(patterns: Iterable[str]) -> list[Row]:
    environments, rows = EnvironmentResolver(), list[Row]()
    for simulator in simulators.simulators().values():
        if simulator.internal:
            continue
        environment = environments.resolve(simulator)  # Its files have the instructions.
        shared: Row = {"simulator": simulator.title, "installed": not environments.missing_reason(simulator)}
        with looking_in(() if environment is None else environment.site_packages):
            for name, task in simulator.tasks.items():
                row: Row = {"task": f"{simulator.name}/{name}", "instruction": task.instruction}
                rows.append(row | {"horizon": task.horizon} | shared)
    names = [str(row["task"]) for row in rows]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            whole = [f"{pattern}/*"] if any(name.startswith(f"{pattern}/") for name in names) else ()
            raise BadInput(f"no task matches '{pattern}'{did_you_mean(pattern, names, meant=whole)}")
    chosen = [*patterns] or ["*"]
    return [row for row, name in zip(rows, names, strict=True) if any(fnmatchcase(name, one) for one in chosen)]


def _abbreviated(rows: list[Row]) -> list[Row]:
    """One row for all tasks of a simulator that has many."""
    counts = Counter(row["simulator"] for row in rows)
    kept: dict[str, Row] = {}
    for row in rows:
        if counts[row["simulator"]] <= MOST_LINES:
            kept[str(row["task"])] = row
            continue
        name = f"{str(row['task']).partition('/')[0]}/*"
        said = f"{counts[row['simulator']]:,} tasks: robogauntlet list tasks '{name}'"
        kept.setdefault(name, row | {"task": name, "instruction": said, "horizon": ""})
    return list(kept.values())
