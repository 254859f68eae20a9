"""A table of trials as CSV: the columns policy, task, success, and trial, seed or state."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any

from robogauntlet.results.store.foreign.trials import (
    MOST_TRIALS,
    BadResults,
    Results,
    Trial,
    check_number,
    read_label,
    read_success,
    task_name,
)
from robogauntlet.support.text import first_of, visible

SOURCE = "a table of trials"
COLUMNS = ("policy", "task", "success")
PAIRING = ("seed", "state")
"""Columns whose value says from which state a trial starts."""
NUMBERS = ("trial", *PAIRING)
MOST_NAMED = 6
"""Columns that a message names."""


def read_csv(content: bytes, policy: str | None = None, task: str | None = None) -> Results:
    """Read a table of trials.

    Args:
        content: The file.
        policy: Name of the policy of a table without that column.
        task: Task of a table without that column.

    Raises:
        BadResults: It is none.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadResults("expected a table of trials as CSV in UTF-8, this is something else") from None
    lines = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        header = next(lines, [])
        names = [name.strip().lower() for name in header]
        stated = {name: value for name, value in (("policy", policy), ("task", task)) if value is not None}
        number = _number_column(names, stated)
        trials = list(islice(_trials(lines, names, number, stated), MOST_TRIALS + 1))
    except csv.Error as error:
        raise BadResults(f"line {lines.line_num}: expected CSV, {error}") from None
    if not trials:
        raise BadResults("expected a table of trials, it has none")
    ignored = [visible(name.strip())[:40] for name in header if name.strip().lower() not in (*COLUMNS, number)]
    notes = (f"columns ignored: {first_of(ignored, MOST_NAMED)}",) if ignored else ()
    return Results(SOURCE, tuple(check_number(trials)), number in PAIRING, notes)


def _number_column(names: list[str], stated: Mapping[str, str]) -> str:
    """The column that numbers the trials. Raises BadResults if that, or another column, is missing or there twice."""
    got = f"got {first_of([visible(name)[:40] or '-' for name in names], MOST_NAMED) or 'none'}"
    needed = [name for name in COLUMNS if name not in stated]
    if unwanted := [name for name in stated if name in names]:
        raise BadResults(f"expected no --{unwanted[0]}, the table has a column {unwanted[0]}")
    if missing := [name for name in needed if name not in names]:
        option = "" if missing[0] == "success" else f" or --{missing[0]} NAME"
        raise BadResults(f"expected a column {missing[0]}{option}, {got}")
    numbers = [name for name in NUMBERS if name in names]
    if len(numbers) != 1:
        words = "remove or rename the others" if numbers else "number the trials, or name their start states"
        raise BadResults(f"expected one column of trial, seed or state, {got}; {words}")
    if doubled := [name for name in (*needed, numbers[0]) if names.count(name) > 1]:
        raise BadResults(f"expected one column {doubled[0]}, got {names.count(doubled[0])}")
    return numbers[0]


def _trials(lines: Any, names: list[str], number: str, stated: Mapping[str, str]) -> Iterator[Trial]:
    for values in lines:
        where = f"line {lines.line_num}"
        if not any(value.strip() for value in values):
            continue
        if len(values) != len(names):
            raise BadResults(f"{where}: expected {len(names)} values, got {len(values)}")
        row = dict(zip(names, values, strict=True)) | dict(stated)
        yield Trial(
            policy=read_label(row["policy"], "policy", where),
            task=task_name(read_label(row["task"], "task", where)),
            label=read_label(row[number], number, where),
            success=read_success(row["success"], where),
        )
