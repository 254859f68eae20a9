"""What is written of a run, whichever logger it is written to: numbers, names and versions, and no free text.

Reasons, descriptions, suite files, paths and URLs of stores are left out: anything may stand in them, and what a logger
has been given, others read.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from results.run import RunDocument
from results.tables import CellRow, Tables, Tally
from suites.vocabulary import CLEAN

COLUMNS = (
    *("simulator", "task", "policy", "policy_digest", "axis", "severity"),
    *("success_rate", "low", "high", "n", "successes", "errors", "missing"),
)
LONGEST_TAG = 64
"""W&B takes no longer ones."""
_UNUSABLE = re.compile(r"[^A-Za-z0-9_.\- /]")
"""What MLflow takes in no name; the colon, which it takes, is kept for `_usable`."""
_PROJECT = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.\- ]{0,127}")


class LoggingError(Exception):
    """A run could not be logged; the text says what is missing or what came, in a line, without secrets."""


@dataclass(frozen=True)
class Entry:
    """What is written of a run."""

    provenance: dict[str, str | int | float | bool]
    """With what it was made; it never changes."""
    state: dict[str, str | int | float | bool]
    """How far it came; it may change when the run is continued."""
    tags: tuple[str, ...]
    metrics: dict[str, float]
    """`success_rate/POLICY/TASK` and so on; if perturbed `.../AXIS/SEVERITY`. What there is not is left out."""
    rows: tuple[tuple[Any, ...], ...]
    """The same as a table with the columns `COLUMNS`; rates are shares, None where there is none."""


def entry_of(document: RunDocument, tables: Tables) -> Entry:
    """What is written of a run."""
    made = document.provenance
    provenance = {
        "run_id": document.run_id,
        "suite": document.suite_name,
        "suite_hash": document.suite_hash,
        "started_at": document.started_at,
        "git_commit": made.git_commit,
        "git_dirty": made.git_dirty,
        "python": made.python,
        "platform": made.platform,
        "processor": made.processor,
        "cores": made.cores,
        **{f"packages/{_usable(name)}": version for name, version in made.versions.items()},
        **{f"policies/{_usable(cell.policy)}": cell.policy_digest for cell in document.plan},
    }
    state = {
        "status": str(document.status),
        "rows_hash": document.rows_hash,
        "planned": document.planned,
        "elapsed_s": document.elapsed_s,
        "inference": document.inference,
        "skipped": ", ".join(sorted(document.skipped)) or None,
        **{f"renderer/{_usable(name)}": device for name, device in document.render_devices.items()},
    }
    tags = dict.fromkeys(["gauntlet", document.suite_name, *tables.simulators])
    metrics: dict[str, float] = {}
    for cell in tables.cells:
        for name, value in _numbers(cell.tally).items():
            # Of two contents by one name the first is that of the plan; the table has both.
            metrics.setdefault(f"{name}/{_place(cell)}", value)
    metrics |= {f"{name}/all": value for name, value in _numbers(tables.total).items()}
    return Entry(
        provenance={name: value for name, value in provenance.items() if value is not None},
        state={name: value for name, value in state.items() if value is not None},
        tags=tuple(tag[:LONGEST_TAG] for tag in tags),
        metrics=metrics,
        rows=tuple(map(_row, tables.cells)),
    )


def check_project(project: str) -> None:
    """Raise LoggingError if a name is none that every logger takes."""
    if not _PROJECT.fullmatch(project):
        raise LoggingError(
            "the project's name: expected at most 128 letters, digits, spaces and . _ -, with a letter or digit first"
        )


def _numbers(tally: Tally) -> dict[str, float]:
    interval = tally.interval
    found = {
        "success_rate": tally.rate,
        "success_rate_low": interval.low if interval else None,
        "success_rate_high": interval.high if interval else None,
        "n": tally.verdicts,
        "errors": tally.errors,
        "missing": tally.missing,
    }
    return {name: float(value) for name, value in found.items() if value is not None}


def _place(cell: CellRow) -> str:
    clean = cell.axis == CLEAN
    return _usable("/".join([cell.policy, cell.task, *([] if clean else [cell.axis, str(cell.severity)])]))


def _usable(name: str) -> str:
    """A name in characters that every logger takes; different names stay different."""
    return _UNUSABLE.sub(lambda found: f":{ord(found[0]):x}:", name)


def _row(cell: CellRow) -> tuple[Any, ...]:
    tally, interval = cell.tally, cell.tally.interval
    return (
        *(cell.simulator, cell.task, cell.policy, cell.policy_digest, cell.axis, cell.severity),
        *(tally.rate, interval.low if interval else None, interval.high if interval else None),
        *(tally.verdicts, tally.successes, tally.errors, tally.missing),
    )
