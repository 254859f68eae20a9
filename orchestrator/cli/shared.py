"""What the verbs share: consoles, exit codes, tables."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from orchestrator.plan import WHOLE, Plan, PlanError, find_suite, make_plan
from results.run import RUN_FILE
from suites.loading import SuiteError
from suites.part import Part

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


def newest_run(root: Path = Path("runs")) -> Path:
    """The run folder under `root` that was touched last.

    Raises:
        BadInput: There is none.
    """
    found = sorted(root.glob(f"*/{RUN_FILE}"), key=lambda path: path.stat().st_mtime)
    if not found:
        raise BadInput(f"no run under {root}/; name one")
    return found[-1].parent
