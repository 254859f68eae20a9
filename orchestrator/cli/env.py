"""`robogauntlet env`: Python environments for simulators that do not fit into the running environment."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.cli.common import fail, out, print_line
from robogauntlet.orchestrator.environments import installer
from robogauntlet.orchestrator.environments.check import check
from robogauntlet.orchestrator.environments.environment import (
    Environment,
    EnvironmentUser,
    adapter_environment,
    config_path,
    declared_environments,
    environment_users,
)
from robogauntlet.orchestrator.environments.pythons import SEARCHED, find_python
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.registry import find_suite, load_registry
from robogauntlet.suites.loading import load_suite
from robogauntlet.suites.plugins import did_you_mean
from robogauntlet.support.durations import format_duration
from robogauntlet.support.errors import BadInput

app = typer.Typer(no_args_is_help=True)

Name = Annotated[
    str, typer.Argument(help="Name of a simulator or policy kind with its own environment, such as libero.")
]
InSuite = Annotated[
    str | None,
    typer.Option("--suite", help="Suite whose `environments` describe it; by default the user's configuration."),
]


@app.command()
def create(
    name: Name,
    suite: InSuite = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Replace an existing environment.")] = False,
) -> None:
    """Create the environment of a simulator.

    Exit code 1 if the environment does not fit.
    """
    simulator, environment = _find(name, suite)
    if environment.origin == "its adapter":
        environment = _best(simulator)
    began = time.monotonic()
    with _progress() as log:
        created = installer.create(environment, log, fresh=fresh)
    state = f"created in {format_duration(time.monotonic() - began)}" if created else "exists"
    print_line(f"{name}: {state}: {environment.folder}")
    if environment.origin == "its adapter" and adapter_environment(simulator) is None:
        users = f"which runs use unless a suite or {config_path()} names another one"
        fail(f"{name} is also installed in the running environment, {users}")
    _report_fit(environment, simulator)


@app.command("list")
def list_environments(
    name: Annotated[
        str | None, typer.Argument(help="Only this one: its declaration, folder and versions, and whether it fits.")
    ] = None,
    suite: InSuite = None,
) -> None:
    """List the environments of simulators, or show and check one.

    Unused environment folders are listed, too. An environment fits if it has what its simulator needs, undamaged, and
    matches the running environment; exit code 1 if the one that is named does not.
    """
    if name is not None:
        _show(name, suite)
        return
    if suite is not None:
        raise BadInput("--suite: expected with the name of an environment")
    environments = EnvironmentResolver()
    table = Table("environment", "declared by", "state", "folder", box=None, pad_edge=False)
    used: set[Path] = set()
    for simulator in environment_users().values():
        environment = environments.resolve(simulator)
        if environment is None:
            continue
        used.add(environment.folder)
        if environment.manifest is None:
            state = "not created"
        else:
            state = "does not fit" if check(environment, simulator).problems else "fits"
        place = environment.entry.interpreter or str(environment.folder)
        table.add_row(simulator.name, environment.origin, state, place)
    for folder in installer.all_folders():
        if folder not in used:
            state = "unused" if (folder / installer.MARKER).exists() else "unfinished"
            table.add_row(folder.name.rpartition("-")[0], "", state, str(folder))
    if table.row_count:
        out.print(table, soft_wrap=True)
    else:
        out.print(f"no simulator has its own environment; {config_path()} or a suite can name one", markup=False)


@app.command()
def remove(name: Name) -> None:
    """Remove all environments of that name."""
    removed = installer.remove(name)
    if not removed:
        raise BadInput(f"{name}: no environment of that name; see: robogauntlet env list")
    for folder in removed:
        print_line(f"removed {folder}")


def _best(user: EnvironmentUser) -> Environment:
    """The first declared environment whose Python is at hand; of several, a line says which and why."""
    environments = declared_environments(user)
    chosen, python = next((one, found) for one in environments if (found := find_python(one.version)) is not None)
    if len(environments) > 1:
        new, old = (
            next(item for item in (*one.entry.requirements, *one.entry.without_dependencies) if user.modules[0] in item)
            for one in (environments[0], chosen)
        )
        wanted = " or ".join(one.version for one in environments[:-1])
        why = "" if new == old else f": {new} needs Python {wanted}, and none that starts is {SEARCHED}"
        print_line(f"{user.name}: {old} with Python {chosen.version}, {python}{why}")
    return chosen


def _show(name: str, suite: str | None) -> None:
    """Print the declaration, the folder and the versions of an environment, and whether it fits."""
    simulator, environment = _find(name, suite)
    contents, manifest = check(environment, simulator), environment.manifest
    created = "no"
    if manifest is not None:
        made_at = manifest.get("made_at")
        created = f"{datetime.fromtimestamp(made_at):%Y-%m-%d %H:%M:%S}" if made_at else "by the user"
    rows = {
        "declared by": environment.origin,
        "hash": environment.entry.hash,
        "entry": json.dumps(environment.entry.model_dump(mode="json", exclude_defaults=True)),
        "python": str(environment.python),
        "created": created,
        **contents.versions,
    }
    table = Table(box=None, pad_edge=False, show_header=False)
    for key, value in rows.items():
        table.add_row(key, escape(value))
    out.print(table, soft_wrap=True)
    _report_fit(environment, simulator)


def _find(name: str, suite: str | None) -> tuple[EnvironmentUser, Environment]:
    known = environment_users()
    if name not in known:
        shown = known.keys() - {name for name, simulator in catalog.simulators().items() if simulator.internal}
        raise BadInput(f"unknown simulator '{name}'{did_you_mean(name, shown)}")
    simulator = known[name]
    declared = {} if suite is None else load_suite(find_suite(suite), load_registry()).environments
    environment = EnvironmentResolver(declared).resolve(simulator) or adapter_environment(simulator, always=True)
    if environment is None:
        remedy = f"add environments: {{{name}: {{requirements: [...]}}}} to {suite or config_path()}"
        raise BadInput(f"{name}: runs in the running environment; to give it its own environment, {remedy}")
    return simulator, environment


def _report_fit(environment: Environment, simulator: EnvironmentUser) -> None:
    contents = check(environment, simulator, contents=True)
    for problem in contents.problems:
        fail(problem)
    if contents.problems:
        raise typer.Exit(1)
    versions = ", ".join(f"{name} {version}" for name, version in contents.versions.items())
    print_line(f"{simulator.name}: fits: Python {contents.python}, {versions}")


@contextlib.contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """A function that shows progress: on a terminal in one line that changes, else in lines."""
    if not out.is_terminal:
        yield print_line
        return
    with out.status("starting") as status:
        yield lambda line: status.update(escape(line))
