"""Decides from which suite the stored episodes of a run may be played again."""

from __future__ import annotations

from pathlib import Path

from robogauntlet.orchestrator.registry import find_suite
from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.results.run_document import RunDocument, refuse_imported
from robogauntlet.results.run_owner import is_own
from robogauntlet.suites.schema import Suite
from robogauntlet.support.errors import BadInput


def playable_suite(document: RunDocument, folder: Path, named: str | None = None) -> Suite:
    """The suite with the policies and environments that play a run's episodes again: `named`, else the run's own.

    A folder that came from elsewhere is data. What it says is imported, contacted and started by nobody.

    Args:
        document: The document of the run.
        folder: Its folder.
        named: Suite file or shipped suite that the user names.

    Raises:
        BadInput: No suite is named, and this user did not play the run in this folder.
        RunError: The run was imported.
        SuiteError, PlanError: The named suite is wrong.
    """
    refuse_imported(folder, document, "played again")
    if named is not None:
        return make_plan(find_suite(named), require_installed=False).suite
    if is_own(folder, document):
        return document.suite
    raise BadInput(
        f"{folder}: you did not play this run in this folder, so its policies are its author's word; "
        "play it from a suite file of yours: --suite FILE"
    )
