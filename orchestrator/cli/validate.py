"""`gauntlet validate`: check suite files."""

from __future__ import annotations

from typing import Annotated

import typer

from orchestrator.cli.shared import EXIT_BAD_INPUT, BadInput, fail, out, plan_of


def validate(suites: Annotated[list[str], typer.Argument(help="Suite files, or names of shipped suites.")]) -> None:
    """Check suite files; print every mistake with its line."""
    wrong = False
    for suite in suites:
        try:
            plan = plan_of(suite)
        except BadInput as error:
            wrong = True
            fail(str(error))
            continue
        out.print(f"{plan.path}: sound, {plan.episodes} episodes, hash {plan.suite_hash}", markup=False, soft_wrap=True)
    if wrong:
        raise typer.Exit(EXIT_BAD_INPUT)
