"""`robogauntlet search disturbance`: find the smallest disturbance that breaks a policy."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_STOPPED,
    AsJson,
    PolicyOptions,
    Success,
    fail,
    out,
    print_json,
    print_line,
)
from robogauntlet.orchestrator.cli.console_tables import rich_table
from robogauntlet.orchestrator.runs.composition import new_run_folder
from robogauntlet.orchestrator.runs.worst_case_search import (
    SEARCH_FILE,
    SearchedTask,
    SearchRequest,
    SearchStopped,
    plan_search,
    play_search,
)
from robogauntlet.policies.references import FORMS, read_options, read_reference, with_options
from robogauntlet.results.report.worst_cases import boundary_table, confirmation_table, smallest_text
from robogauntlet.results.statistics.worst_case import LEAST_CLEAN
from robogauntlet.suites.ranges import MAX_COUNT
from robogauntlet.suites.schema import MAX_NAME
from robogauntlet.support.text import counted


def search(
    policy: Annotated[str, typer.Option("--policy", help=f"The policy: {FORMS}.")],
    task: Annotated[
        list[str], typer.Option("--task", help="Task (simulator/task), or tasks that match a pattern. Repeatable.")
    ],
    budget: Annotated[
        int, typer.Option("--budget", min=1, max=MAX_COUNT, help="Episodes in all, shared equally by the tasks.")
    ],
    axis: Annotated[
        list[str] | None,
        typer.Option("--axis", help="Only this perturbation axis; by default all that a task can have. Repeatable."),
    ] = None,
    below: Annotated[
        float,
        typer.Option(min=5.0, max=95.0, help="Percent of the clean success below which the policy counts as broken."),
    ] = 50.0,
    option: PolicyOptions = None,
    out_folder: Annotated[
        Path | None,
        typer.Option("--out", help="Folder; by default a new one under runs/. A search that is in it is continued."),
    ] = None,
    success: Success = None,
    seed: Annotated[int, typer.Option(min=0, max=MAX_COUNT, help="Draws the random directions.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Find the smallest disturbance that breaks a policy.

    It is searched along each axis and combined, and confirmed. Broken means that success is below half (--below) of the
    clean rate; small means a small severity, of a combination the Euclidean norm of its severities. Three fifths of the
    budget search, the rest plays what was found on fresh seeds: from 10,000 on, or further stored states.
    """
    (entry,) = with_options([read_reference(policy)], read_options(option or ()))
    request = SearchRequest(entry, tuple(task), tuple(axis or ()), budget, below / 100, seed, success)
    searches = plan_search(request)
    folder = out_folder or new_run_folder(f"search-{entry.name}"[:MAX_NAME])
    said = print_line if not as_json else lambda line: print(line, file=sys.stderr)
    said(f"{counted(budget, 'episode')} into {folder}")
    for one in searches:
        for name, reason in one.skipped.items():
            said(f"{one.task}: {name} is skipped: {reason}")
        if one.start_states is not None:
            said(
                f"{one.task}: its {one.start_states} stored states are played once each, which may end the budget early"
            )
    again = f"continue with: {_command(folder)}"
    try:
        found = play_search(request, searches, folder, said)
    except KeyboardInterrupt:
        fail(f"interrupted; {again}")
        raise typer.Exit(EXIT_INTERRUPTED) from None
    except SearchStopped as error:
        fail(f"stopped: {error}\n{again}")
        raise typer.Exit(EXIT_STOPPED) from None
    if as_json:
        print_json({"below": request.below, "found": [one.plain() for one in found]})
    else:
        _print(found, request.below)
        print_line(f"found: {folder / SEARCH_FILE}")


def _command(folder: Path) -> str:
    """The command as given, with its folder."""
    given = sys.argv[1:]
    has_folder = any(text.partition("=")[0] == "--out" for text in given)
    return shlex.join(["robogauntlet", *given, *([] if has_folder else ["--out", str(folder)])])


def _print(found: list[SearchedTask], below: float) -> None:
    cases = {one.search.task: one.found for one in found if one.found.axes}
    for one in found:
        if one.errors:
            fail(f"{one.search.task}: {counted(one.errors, 'episode')} could not be played and do not count")
        if not one.found.axes:
            clean = one.found.clean_searched
            least = f"expected a clean success of at least {100 * LEAST_CLEAN:g} % for a search"
            fail(f"{one.search.task}: {least}, got {clean.successes} of {clean.trials}")
    if not cases:
        return
    out.print()
    broken = f"Broken: success below {100 * below:g} % of the clean rate."
    print_line(f"{broken} On the seeds of the search:")
    out.print(rich_table(boundary_table(cases), title="Boundaries in severities"))
    out.print()
    print_line("On fresh seeds, at severities beyond these, with 95 % intervals:")
    out.print(rich_table(confirmation_table(cases, below), title="Confirmation"))
    out.print()
    for task, case in cases.items():
        print_line(f"{task}: {smallest_text(case)}")
