"""`robogauntlet forget`: remove a run from the history."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from typing import Annotated

import typer

from robogauntlet.orchestrator.cli.common import HistoryUrl, open_history, print_line
from robogauntlet.results.folder_lock import LOCK_FILE
from robogauntlet.results.report.formatting import counted
from robogauntlet.results.run_document import RUN_FILE, RunError, read_run
from robogauntlet.results.store.database import without_password
from robogauntlet.results.store.history_records import RunEntry
from robogauntlet.results.store.run_history import SHORTEST_ID
from robogauntlet.support.errors import BadInput, describe_os_error
from robogauntlet.support.files import is_held


def forget(
    run: Annotated[str, typer.Argument(help=f"Name of a run's folder, or {SHORTEST_ID} or more characters of its id.")],
    delete: Annotated[bool, typer.Option("--delete", help="Remove its folder and its rows, too.")] = False,
    url: HistoryUrl = None,
) -> None:
    """Remove a run from the history.

    Its folder stays unless --delete is given, and is not recorded again; importing or continuing the run does.
    """
    with open_history(url) as history:
        entry = history.find(Path(run).name)
        if entry is None:
            raise BadInput(f"no run '{run}' in the history; see: robogauntlet history")
        here = entry.rows_url is not None and entry.rows_url == without_password(history.url)
        if here and not delete:
            raise BadInput(f"{entry.name}: expected --delete, since its rows are in the history's own database")
        folder = _folder_of(entry)
        rows = history.forget(entry.run_id, None if delete or folder is None else str(folder))
    removed = ["the history"]
    if rows:
        removed.append(f"{counted(rows, 'row')} in it")
    if delete and folder is not None:
        try:
            shutil.rmtree(folder)
        except OSError as error:
            raise BadInput(f"{folder}: forgotten, but it cannot be removed: {describe_os_error(error)}") from None
        removed.append(f"the folder {folder}")
    print_line(f"{entry.name}: removed {' and '.join(['from ' + removed[0], *removed[1:]])}")
    if folder is not None and not delete:
        print_line(f"its folder stays: {folder}")
    if entry.rows_url is not None and not here:
        print_line(f"its rows stay in {entry.rows_url}")


def _folder_of(entry: RunEntry) -> Path | None:
    """The folder of a run that has ended, or None if it is gone. Raises BadInput."""
    folder = Path(entry.folder) if entry.folder else None
    if folder is None or not (folder / RUN_FILE).exists():
        return None
    if is_held(folder / LOCK_FILE):
        raise BadInput(f"{folder}: expected a run that has ended, a process is running it; stop it first")
    with contextlib.suppress(RunError):  # a broken run can be forgotten, too
        if (found := read_run(folder).run_id) != entry.run_id:
            raise BadInput(f"{folder}: expected run {entry.run_id}, the folder has run {found}")
    return folder
