"""`gauntlet env`: Python environments for simulators that do not fit into the running one."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from adapters import catalog
from orchestrator.cli.shared import BadInput, environments_of, fail, homes_here, out
from orchestrator.environments import creating
from orchestrator.environments.checking import check
from orchestrator.environments.environment import (
    Environment,
    EnvironmentProblem,
    Tenant,
    by_default,
    config_path,
    tenants,
)
from orchestrator.progress import format_duration
from suites.plugins import nearest

app = typer.Typer(no_args_is_help=True, help="Python environments for simulators that do not fit into the running one.")

Name = Annotated[str, typer.Argument(help="Of a simulator, such as libero.")]
InSuite = Annotated[
    str | None,
    typer.Option("--suite", help="A suite whose `environments` say what it is to be; else the configuration."),
]


@app.command()
def create(
    name: Name,
    suite: InSuite = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Make it anew although it is there.")] = False,
) -> None:
    """Make a simulator's environment, as a whole or not at all. Exit code 1: made, and does not fit."""
    simulator, environment = _find(name, suite)
    began = time.monotonic()
    try:
        with _telling() as say:
            made = creating.create(environment, say, fresh=fresh)
    except EnvironmentProblem as error:
        raise BadInput(str(error)) from None
    seconds = format_duration(time.monotonic() - began)
    out.print(
        f"{name}: {f'made in {seconds}' if made else 'is there'}: {environment.folder}", markup=False, soft_wrap=True
    )
    if environment.origin == "its adapter" and by_default(simulator) is None:
        fail(
            f"{name} is installed in the running environment, which is what runs use unless a suite or {config_path()} "
            "names another"
        )
    _judge(environment, simulator)


@app.command("list")
def list_environments() -> None:
    """List the environments that simulators have or could have, and what lies about besides."""
    homes = homes_here()
    table = Table("environment", "asked for by", "state", "folder", box=None, pad_edge=False)
    meant: set[Path] = set()
    for simulator in tenants().values():
        environment = homes.of(simulator)
        if environment is None:
            continue
        meant.add(environment.folder)
        state = "does not fit" if check(environment, simulator).problems else "fits"
        state = "not made" if environment.made is None else state
        place = environment.entry.interpreter or str(environment.folder)
        table.add_row(simulator.name, environment.origin, state, place)
    for folder in creating.all_folders():
        if folder not in meant:
            begun = "not asked for here" if (folder / creating.MARKER).exists() else "unfinished"
            table.add_row(folder.name.rpartition("-")[0], "", begun, str(folder))
    if table.row_count:
        out.print(table, soft_wrap=True)
    else:
        out.print(f"no simulator has an environment of its own; {config_path()} or a suite can name one", markup=False)


@app.command()
def show(name: Name, suite: InSuite = None) -> None:
    """What an environment is made of, where it lies, and what is in it."""
    simulator, environment = _find(name, suite)
    entry = environment.entry.model_dump(mode="json", exclude_defaults=True)
    found = check(environment, simulator)
    rows = {
        "asked for by": environment.origin,
        "hash": environment.entry.hash,
        "entry": json.dumps(entry),
        "python": str(environment.python),
        "made": "no" if environment.made is None else _moment(environment.made.get("made_at")),
        **found.versions,
    }
    table = Table(box=None, pad_edge=False, show_header=False)
    for key, value in rows.items():
        table.add_row(key, value)
    out.print(table, soft_wrap=True)
    _judge(environment, simulator)


@app.command("check")
def check_environment(name: Name, suite: InSuite = None) -> None:
    """Hold an environment against the running one and against what its simulator needs. Exit code 1: does not fit."""
    simulator, environment = _find(name, suite)
    _judge(environment, simulator)


@app.command()
def remove(name: Name) -> None:
    """Remove all environments that were made under a name."""
    try:
        removed = creating.remove(name)
    except EnvironmentProblem as error:
        raise BadInput(str(error)) from None
    if not removed:
        raise BadInput(f"{name}: expected an environment of that name, there is none; gauntlet env list")
    for folder in removed:
        out.print(f"removed {folder}", markup=False, soft_wrap=True)


def _find(name: str, suite: str | None) -> tuple[Tenant, Environment]:
    known = tenants()
    if name not in known:
        shown = known.keys() - {one.name for one in catalog.simulators().values() if one.internal}
        raise BadInput(f"unknown simulator '{name}'{nearest(name, shown)}")
    simulator = known[name]
    declared = environments_of(suite) if suite is not None else {}
    environment = homes_here(declared).of(simulator) or by_default(simulator, anyway=True)
    if environment is None:
        where = suite or str(config_path())
        raise BadInput(
            f"{name}: runs in the running environment; to give it one of its own, add environments: "
            f"{{{name}: {{requirements: [...]}}}} to {where}"
        )
    return simulator, environment


def _judge(environment: Environment, simulator: Tenant) -> None:
    found = check(environment, simulator)
    for problem in found.problems:
        fail(problem)
    if found.problems:
        raise typer.Exit(1)
    versions = ", ".join(f"{name} {version}" for name, version in found.versions.items())
    out.print(f"{simulator.name}: fits: Python {found.python}, {versions}", markup=False, soft_wrap=True)


def _moment(seconds: float | None) -> str:
    return "by its owner" if seconds is None else f"{datetime.fromtimestamp(seconds):%Y-%m-%d %H:%M:%S}"


@contextlib.contextmanager
def _telling() -> Iterator[Callable[[str], None]]:
    """What is done: a line that changes on a terminal, lines elsewhere."""
    if not out.is_terminal:
        yield lambda line: out.print(line, markup=False, soft_wrap=True)
        return
    with out.status("beginning") as status:
        yield lambda line: status.update(line.replace("[", "\\["))
