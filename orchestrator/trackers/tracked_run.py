"""The results of a run as experiment trackers receive them: numbers, names and versions, no free text.

Reasons, descriptions, suite files, paths and URLs of stores are left out, since they may contain secrets and other
people can read what a tracker stores.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robogauntlet.results.run_document import RunStatus
from robogauntlet.suites.episode import CLEAN
from robogauntlet.support.errors import BadInput

if TYPE_CHECKING:
    from robogauntlet.results.analysis.tables import CellRow, Tables, Tally
    from robogauntlet.results.run_document import RunDocument

COLUMNS = (
    *("simulator", "task", "policy", "policy_digest", "axis", "severity"),
    *("success_rate", "low", "high", "n", "successes", "errors", "missing"),
)
LONGEST_TAG = 64
"""Characters; W&B refuses longer tags."""
_UNUSABLE = re.compile(r"[^A-Za-z0-9_.\- /]")
"""Characters that `usable` replaces: those that MLflow refuses in names, and the colon, which marks replacements."""
_PROJECT = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.\- ]{0,127}")


class TrackerError(BadInput):
    """A run could not be sent to a tracker. The message is one line without secrets."""


@dataclass(frozen=True)
class TrackedRun:
    """The results of a run for an experiment tracker, in plain values."""

    run_id: str
    status: str
    """A `RunStatus`."""
    started_at: float
    """Seconds since 1970, UTC."""
    ended_at: float | None
    """The same of the end; None while the run plays."""
    provenance: dict[str, str | int | float | bool]
    """Software, hardware and policies; they never change."""
    state: dict[str, str | int | float | bool]
    """Status and progress; they change when the run is continued."""
    tags: tuple[str, ...]
    metrics: dict[str, float]
    """`success_rate/POLICY/TASK` and so on, with `/AXIS/SEVERITY` if perturbed; without undefined rates."""
    rows: tuple[tuple[Any, ...], ...]
    """The same as a table with the columns `COLUMNS`; rates are shares, None if undefined."""
    cells: str
    """The content of `cells.csv`; empty at the start of a run."""


def tracked_run(document: RunDocument, tables: Tables | None) -> TrackedRun:
    """Collect the results of a run for an experiment tracker; without tables, what is known at its start."""
    from robogauntlet.results.report.summary import render_csv

    source = document.provenance
    provenance = {
        "run_id": document.run_id,
        "suite": document.suite.name,
        "suite_hash": document.suite_hash,
        "started_at": document.started_at,
        "git_commit": source.git_commit,
        "git_dirty": source.git_dirty,
        "python": source.python,
        "platform": source.platform,
        "processor": source.processor,
        "cores": source.cores,
        **{f"packages/{usable(name)}": version for name, version in source.versions.items()},
        **{f"policies/{usable(cell.policy)}": cell.policy_digest for cell in document.plan},
    }
    state = {
        "status": str(document.status),
        "rows_hash": document.rows_hash,
        "planned": document.planned,
        "elapsed_s": document.elapsed_s,
        "inference": document.inference,
        "skipped": ", ".join(sorted(document.skipped)) or None,
        **{f"renderer/{usable(name)}": device for name, device in document.render_devices.items()},
    }
    simulators = [cell.simulator for cell in document.plan] if tables is None else tables.simulators
    tags = dict.fromkeys(["robogauntlet", document.suite.name, *simulators])
    metrics: dict[str, float] = {}
    for cell in tables.cells if tables else ():
        for name, value in _numbers(cell.tally).items():
            # If one policy name has two contents, the first is the planned one; the table has both.
            place = place_of(cell.policy, cell.task, axis=cell.axis, severity=cell.severity)
            metrics.setdefault(f"{name}/{place}", value)
    metrics |= {f"{name}/all": value for name, value in _numbers(tables.total).items()} if tables else {}
    ended_at = document.finished_at or document.started_at + document.elapsed_s
    return TrackedRun(
        run_id=document.run_id,
        status=str(document.status),
        started_at=document.started_at,
        ended_at=None if document.status is RunStatus.RUNNING else ended_at,
        provenance={name: value for name, value in provenance.items() if value is not None},
        state={name: value for name, value in state.items() if value is not None},
        tags=tuple(tag[:LONGEST_TAG] for tag in tags),
        metrics=metrics,
        rows=tuple(map(_row, tables.cells)) if tables else (),
        cells=render_csv(tables) if tables else "",
    )


def check_project(project: str) -> None:
    """Raise TrackerError unless every tracker accepts the name of a project."""
    if not _PROJECT.fullmatch(project):
        raise TrackerError(
            "the project's name: expected at most 128 letters, digits, spaces and . _ -, with a letter or digit first"
        )


def _numbers(tally: Tally) -> dict[str, float]:
    numbers = {"success_rate": tally.rate, "n": tally.verdicts, "errors": tally.errors, "missing": tally.missing}
    if tally.interval:
        numbers |= {"success_rate_low": tally.interval.low, "success_rate_high": tally.interval.high}
    return {name: float(value) for name, value in numbers.items() if value is not None}


def place_of(*names: str, axis: str, severity: int) -> str:
    """`POLICY`, `POLICY/TASK` and so on in usable characters, with `/AXIS/SEVERITY` if perturbed."""
    return usable("/".join([*names, *([] if axis == CLEAN else [axis, str(severity)])]))


def usable(name: str) -> str:
    """A name in characters that every tracker accepts; different names stay different."""
    return _UNUSABLE.sub(lambda match: f":{ord(match[0]):x}:", name)


def _row(cell: CellRow) -> tuple[Any, ...]:
    tally, interval = cell.tally, cell.tally.interval
    return (
        *(cell.simulator, cell.task, cell.policy, cell.policy_digest, cell.axis, cell.severity),
        *(tally.rate, interval.low if interval else None, interval.high if interval else None),
        *(tally.verdicts, tally.successes, tally.errors, tally.missing),
    )
