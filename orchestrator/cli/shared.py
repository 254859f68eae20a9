"""What the verbs share: consoles, exit codes, tables."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from orchestrator.environments.homes import Homes
from orchestrator.names import known_names
from orchestrator.plan import WHOLE, Plan, PlanError, find_suite, make_plan
from results.database import StoreError, file_url, parse
from results.history import HISTORY_FILE, History
from results.run import RUN_FILE
from results.syncing import take_in
from suites.environments import EnvironmentEntry
from suites.loading import SuiteError, load_suite
from suites.part import Part

RUNS = Path("runs")
EXIT_BAD_INPUT = 2
EXIT_STOPPED = 3
EXIT_INTERRUPTED = 130

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)
if not out.is_terminal and "COLUMNS" not in os.environ:
    out.width = 160  # a file or a pipe has no width of its own


Policies = Annotated[
    list[str] | None,
    typer.Option("--policy", help="Only this policy of the suite, or those of a pattern. Repeatable."),
]
Tasks = Annotated[
    list[str] | None, typer.Option("--task", help="Only this task of the suite, or those of a pattern. Repeatable.")
]
StoreUrl = Annotated[
    str | None, typer.Option("--store", help="URL of the run's store, if it is not in the run folder.")
]
HistoryUrl = Annotated[
    str | None,
    typer.Option(
        "--history",
        envvar="GAUNTLET_HISTORY",
        show_envvar=True,
        help="URL of the store that knows all runs; by default history.sqlite beside the run folders.",
    ),
]
SeedCount = Annotated[int | None, typer.Option("--seeds", help="Only the first so many seeds of the suite.")]


class BadInput(Exception):
    """The user asked for something that cannot be; its text has one line per problem."""


def fail(message: str) -> None:
    """Print problems to standard error, a line each."""
    for line in message.splitlines():
        err.print(f"gauntlet: {line}", markup=False, soft_wrap=True)


def plan_of(suite: str, *, part: Part = WHOLE, only: tuple[str, ...] = ()) -> Plan:
    """The plan of a suite file or shipped suite, or of a part of it.

    Raises:
        BadInput: It cannot be run.
    """
    try:
        return make_plan(find_suite(suite), part=part, only=only)
    except (SuiteError, PlanError) as error:
        raise BadInput(str(error)) from None


def environments_of(suite: str) -> dict[str, EnvironmentEntry]:
    """The environments that a suite declares.

    Raises:
        BadInput: It is wrong.
    """
    try:
        return load_suite(find_suite(suite), known_names()).environments
    except SuiteError as error:
        raise BadInput(str(error)) from None


def homes_here(declared: Mapping[str, EnvironmentEntry] | None = None) -> Homes:
    """In which environment each simulator runs.

    Raises:
        BadInput: The user's configuration is wrong.
    """
    try:
        return Homes(declared)
    except SuiteError as error:
        raise BadInput(str(error)) from None


def newest_run(root: Path = RUNS) -> Path:
    """The run folder under `root` that was touched last.

    Raises:
        BadInput: There is none.
    """
    found = sorted(root.glob(f"*/{RUN_FILE}"), key=lambda path: path.stat().st_mtime)
    if not found:
        raise BadInput(f"no run under {root}/; name one")
    return found[-1].parent


def history_url(url: str | None, root: Path = RUNS) -> str:
    """URL of the history: the one given, or that of the file beside the run folders.

    Raises:
        BadInput: It is no URL of a store.
    """
    if url is None:
        return file_url((root / HISTORY_FILE).absolute())
    try:
        return parse(url).render_as_string(hide_password=False)
    except StoreError as error:
        raise BadInput(str(error)) from None


def runs_root(url: str | None) -> Path:
    """Where runs are looked for and put: beside a history that is a file, else `runs`."""
    parsed = parse(history_url(url))
    return Path(parsed.database).parent if parsed.get_backend_name() == "sqlite" and parsed.database else RUNS


@contextmanager
def open_history(url: str | None, root: Path | None = None) -> Iterator[History]:
    """The history, told of the runs beside it that it does not know.

    Args:
        url: Where it is, or None for the file beside the run folders.
        root: Of the run folders; None for what `runs_root` says.

    Raises:
        BadInput: It cannot be opened, read or written.
    """
    root = root or runs_root(url)
    try:
        if url is None:
            root.mkdir(parents=True, exist_ok=True)
        history = History.open(history_url(url, root))
        try:
            take_in(history, root)
            yield history
        finally:
            history.close()
    except StoreError as error:
        raise BadInput(str(error)) from None
    except OSError as error:
        raise BadInput(f"{root}: {error.strerror}") from None
