"""`robogauntlet validate`: check suite files."""

from __future__ import annotations

from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import EXIT_BAD_INPUT, fail, print_line
from robogauntlet.orchestrator.runs.plan import PlanError, find_suite, make_plan
from robogauntlet.suites.loading import SuiteError


def validate(suites: Annotated[list[str], typer.Argument(help="Suite files, or names of shipped suites.")]) -> None:
    """Check suite files and report every mistake with its line.

    Neither simulators nor the packages of policies need to be installed; what is missing on this machine is listed.
    """
    valid = True
    for suite in suites:
        try:
            plan = make_plan(find_suite(suite), require_installed=False)
        except (SuiteError, PlanError) as error:
            valid = False
            fail(str(error))
            continue
        if not plan.suite.policies:
            print_line(f"{plan.path}: valid, {len(plan.suite.tasks)} tasks for the policy named by --policy")
            continue
        print_line(f"{plan.path}: valid, {plan.episodes} episodes, hash {plan.suite_hash}")
        for simulator, reason in plan.unavailable.items():
            print_line(f"  note: simulator {simulator}: {reason}")
        if plan.not_installed:
            names = ", ".join(list(plan.not_installed)[:3]) + (", ..." if len(plan.not_installed) > 3 else "")
            reasons = "; ".join(dict.fromkeys(plan.not_installed.values()))
            print_line(f"  note: not checked whether the policies {names} fit the suite: {reasons}")
    if not valid:
        raise typer.Exit(EXIT_BAD_INPUT)
