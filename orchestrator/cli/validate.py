"""`robogauntlet validate`: check suite files."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import typer

from robogauntlet.orchestrator.cli.common import EXIT_BAD_INPUT, AsJson, Check, fail, print_json, print_line
from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.orchestrator.runs.plan import Plan, make_plan
from robogauntlet.orchestrator.runs.suite_names import PlanError
from robogauntlet.suites.loading import SuiteError
from robogauntlet.support.text import counted


def validate(
    suites: Annotated[list[str], typer.Argument(help="Suite files, or names of shipped suites.")],
    check: Check = False,
    as_json: AsJson = False,
) -> None:
    """Check suite files and report every mistake with its line.

    Neither simulators nor the packages of policies need to be installed; what is missing on this machine is listed.
    Nothing that a suite names is imported, contacted or started, unless --check is given.
    """
    found: list[dict[str, Any]] = []
    for suite in suites:
        try:
            plan = make_plan(find_suite(suite), require_installed=False, start=check)
        except (SuiteError, PlanError) as error:
            found.append({"suite": suite, "mistakes": str(error).splitlines()})
        else:
            numbers = {"episodes": plan.episodes, "hash": plan.suite_hash}
            found.append({"suite": str(plan.path), "mistakes": [], **numbers, "notes": list(_notes(plan))})
    if as_json:
        print_json(found)
    for row in [] if as_json else found:
        for mistake in row["mistakes"]:
            fail(mistake)
        if not row["mistakes"]:
            print_line(f"{row['suite']}: valid, {counted(row['episodes'], 'episode')}, hash {row['hash']}")
            for note in row["notes"]:
                print_line(f"  note: {note}")
    if any(row["mistakes"] for row in found):
        raise typer.Exit(EXIT_BAD_INPUT)


def _notes(plan: Plan) -> Iterator[str]:
    """What is missing in the suite or on this machine."""
    if plan.suite.needs is not None:
        suite = plan.suite
        episodes = len(suite.tasks) * len(suite.all_conditions()) * suite.seeds.count * (1 + len(suite.policies))
        yield f"needs a policy, to play {counted(episodes, 'episode')}; add --policy to robogauntlet run"
    yield from plan.notes
    yield from plan.warnings
    for simulator, reason in plan.unavailable.items():
        yield f"simulator {simulator}: {reason}"
    if plan.unchecked:
        names = ", ".join(list(plan.unchecked)[:3]) + (", ..." if len(plan.unchecked) > 3 else "")
        reasons = "; ".join(dict.fromkeys(plan.unchecked.values()))
        yield f"not checked whether the policies {names} fit the suite: {reasons}"
