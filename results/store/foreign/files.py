"""Reads files of results of others by their formats."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from robogauntlet.results.run_document import RunError
from robogauntlet.results.store.foreign.csv_table import read_csv
from robogauntlet.results.store.foreign.json_file import read_json
from robogauntlet.results.store.foreign.trials import LARGEST_FILE, BadResults, Results, check_number
from robogauntlet.support.files import RefusedFile, read_regular

READERS: Mapping[str, Callable[..., Results]] = {".csv": read_csv, ".json": read_json}
"""End of a file's name to what reads its content, given the policy and the task of the user, or None."""


def is_foreign(file: Path) -> bool:
    """Whether a file is, by its name, results of others and no exported run."""
    return file.suffix.lower() in READERS


def read_files(
    files: Sequence[Path], policies: Sequence[str] = (), *, task: str | None = None, paired: bool = False
) -> Results:
    """Read the files of one import.

    Args:
        files: Files of which `is_foreign` is true.
        policies: The policy of each file, for files that do not name it; or none.
        task: The task, for files that do not name it.
        paired: Whether the user says that trials with one task and number start from the same state.

    Raises:
        RunError: A file cannot be read or is of no known format, or the files cannot be one run.
    """
    if policies and len(policies) != len(files):
        raise RunError(f"expected one --policy for each of {len(files)} files, got {len(policies)}")
    named: Sequence[str | None] = policies or [None] * len(files)
    found = [_read(file, policy, task) for file, policy in zip(files, named, strict=True)]
    sources = list(dict.fromkeys(one.source for one in found))
    if len(sources) > 1 or len({one.paired for one in found}) > 1:
        what = f"got {' and '.join(sources)}" if len(sources) > 1 else "only some of these name start states"
        raise RunError(f"expected files of one kind in an import, {what}")
    trials = [trial for one in found for trial in one.trials]
    notes = tuple(dict.fromkeys(note for one in found for note in one.notes))
    try:
        check_number(trials)
    except BadResults as error:
        raise RunError(f"{files[0]}: {error}") from None
    return replace(found[0], trials=tuple(trials), paired=paired or found[0].paired, notes=notes)


def _read(file: Path, policy: str | None, task: str | None) -> Results:
    try:
        return READERS[file.suffix.lower()](read_regular(file, LARGEST_FILE), policy, task)
    except RefusedFile as error:
        raise RunError(f"{file}: expected a file of results, got {error}") from None
    except OSError as error:
        raise RunError(f"{file}: cannot be read: {error.strerror}") from None
    except BadResults as error:
        raise RunError(f"{file}: {error}") from None
