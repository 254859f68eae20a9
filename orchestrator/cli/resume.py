"""`robogauntlet resume`: continue a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import HistoryUrl, RunArgument, out as console, print_line
from robogauntlet.orchestrator.cli.playing import play_plan
from robogauntlet.orchestrator.cli.run import STORE_VARIABLE
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.trackers import PROJECT, open_tracker
from robogauntlet.policies.references import read_options
from robogauntlet.results.run_document import RunArguments, read_run, refuse_imported
from robogauntlet.results.run_owner import is_own
from robogauntlet.results.store.database import without_password
from robogauntlet.suites.selection import SETTINGS, SuiteSelection
from robogauntlet.support.errors import BadInput


def resume(
    run: RunArgument,
    store: Annotated[
        str | None,
        typer.Option(envvar=STORE_VARIABLE, help="URL of the store, if it has a password, which is not kept."),
    ] = None,
    history: HistoryUrl = None,
    media: Annotated[
        bool | None,
        typer.Option(help="Record all videos, or none; by default as the run was begun.", show_default=False),
    ] = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print a line for each episode.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but problems.")] = False,
) -> None:
    """Continue a run of yours as it was begun.

    Suite, policies, store, history and all other options are those in the run folder.
    """
    console.quiet = quiet or console.quiet
    document = read_run(run)
    refuse_imported(run, document, "continued")
    if not is_own(run, document):
        raise BadInput(
            f"{run}: you did not begin this run in this folder, so what it plays is its author's word; to continue it "
            f"from a suite file of yours: robogauntlet run FILE --out {run}"
        )
    given = document.arguments
    if given is None:
        other = f"continue it with: {document.command}" if document.command else "it was begun from Python"
        raise BadInput(f"{run}: expected a run of `robogauntlet run`; {other}")
    store = store or _kept(document.store_url, "store", run)
    history = history or _kept(given.history, "history", run)
    tracker = None if given.tracker is None else open_tracker(given.tracker, given.project or PROJECT, print_line)
    plan = make_plan(Path(document.suite_path), text=document.suite_text, part=_part(given), only=given.require)
    if media is not None:
        given = given.model_copy(update={"media": media})
    play_plan(plan, run, given, store=store, history=history, tracker=tracker, verbose=verbose)


def _part(given: RunArguments) -> SuiteSelection:
    """The selected part of the suite."""
    settings = {name: value for name in SETTINGS if (value := getattr(given, name)) is not None}
    return SuiteSelection(given.policies, given.tasks, given.seeds, read_options(given.options), settings)


def _kept(url: str | None, option: str, run: Path) -> str | None:
    """The URL in the run document. Raises BadInput if its password is hidden there."""
    if url is not None and "***" in url:
        raise BadInput(f"{run}: its {option} is {without_password(url)}; give that address with --{option}")
    return url
