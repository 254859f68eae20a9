"""The files of a report for programs: `summary.json` and `cells.csv`."""

from __future__ import annotations

import csv
import io
from functools import cache
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, create_model

from robogauntlet.results.analysis.tables import Aggregate, CellRow, ErrorGroup, NotRun, Tables, Tally
from robogauntlet.results.analysis.timing import AnswerTiming, PhaseTiming
from robogauntlet.results.report.formatting import spreadsheet_cell
from robogauntlet.results.report.section import Report, load_sections
from robogauntlet.results.run_document import Provenance, RunStatus
from robogauntlet.results.statistics.rates import CONFIDENCE
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import SuccessRule

SUMMARY_FORMAT = 1
ERROR_GROUPS = 50
"""Maximum number of error messages that are listed."""
COPIED = (
    *("run_id", "suite_hash", "rows_hash", "status", "reason", "started_at", "finished_at", "elapsed_s"),
    *("render_devices", "workers", "shared_workers", "provenance"),
)
"""Fields that the summary has from the run document."""
CSV_HEADER = (
    *("simulator", "task", "policy", "policy_digest", "axis", "severity", "level", "unit"),
    *("planned", "done", "successes", "failures", "errors", "missing", "rate", "low", "high"),
    *("success_once", "mean_steps", "mean_seconds"),
)


class Summary(BaseModel):
    """What `summary.json` has of every run. A `format` only gains fields. Rates are shares in [0, 1]."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    format: int = SUMMARY_FORMAT
    run_id: str
    suite_name: str
    suite_hash: str
    """Hash of the planned episodes; equal for suites that plan the same ones."""
    success_rule: SuccessRule = SuccessRule.HELD
    """When an episode is a success."""
    rows_hash: str | None
    """Hash of all rows without timing, if the run has computed it."""
    status: RunStatus
    reason: str | None
    """Why the run ended early, if it did."""
    started_at: float
    """Seconds since 1970, UTC."""
    finished_at: float | None
    elapsed_s: float
    """Time spent running, over all sessions (s)."""
    confidence: float = CONFIDENCE
    """Confidence of all intervals."""
    total: Tally
    episodes_per_hour: float | None
    policies: tuple[Aggregate, ...]
    """Per policy and condition, over all simulators."""
    simulators: tuple[Aggregate, ...]
    """Per policy, simulator and condition."""
    cells: tuple[CellRow, ...]
    """Per policy, task and condition."""
    timing: tuple[PhaseTiming, ...]
    """Worker time per simulator."""
    answers: tuple[AnswerTiming, ...] = ()
    """Answer times of policies."""
    skipped: dict[str, str]
    """Simulator to the reason why it could not run."""
    not_run: tuple[NotRun, ...]
    """Cells with planned episodes that have no row."""
    errors: tuple[ErrorGroup, ...] = Field(max_length=ERROR_GROUPS)
    error_messages: int
    """Number of distinct error messages; `errors` lists the most frequent."""
    render_devices: dict[str, str]
    """Simulator to its render device."""
    workers: dict[str, int]
    """Simulator to its number of workers in the last session; empty if all simulators shared `shared_workers`."""
    shared_workers: int | None = None
    policy_digests: dict[str, str]
    """Policy to the hash of its content."""
    provenance: Provenance


@cache
def summary_model() -> type[Summary]:
    """Return the type of the content of `summary.json` with the data of all sections, of other distributions too.

    A section that a run has nothing for is null. Severities beyond the last level and infinite lifts are "Infinity".
    """
    fields: dict[str, Any] = {one.name: (one.type | None, None) for one in load_sections() if one.type is not None}
    return create_model("Summary", __base__=Summary, **fields)


def build_summary(report: Report) -> Summary:
    """Return the summary of a report."""
    document, tables, model = report.document, report.tables, summary_model()
    return model(
        **{name: getattr(document, name) for name in COPIED},
        suite_name=document.suite.name,
        success_rule=document.suite.success_rule,
        total=tables.total,
        episodes_per_hour=tables.episodes_per_hour,
        policies=tables.by_policy,
        simulators=tables.by_simulator,
        cells=tables.cells,
        timing=tables.timing,
        answers=tables.answers,
        skipped=dict(tables.skipped),
        not_run=tables.not_run,
        errors=tables.errors[:ERROR_GROUPS],
        error_messages=len(tables.errors),
        policy_digests={cell.policy: cell.policy_digest for cell in tables.cells},
        **{name: value for name, value in report.data.items() if name in model.model_fields},
    )


def render_csv(tables: Tables) -> str:
    """Return `cells.csv`: a line per cell, rates with their 95 % Wilson intervals as shares, missing values empty."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(CSV_HEADER)
    writer.writerows(map(spreadsheet_cell, _csv_line(cell)) for cell in tables.cells)
    return file.getvalue()


def _csv_line(cell: CellRow) -> tuple[object, ...]:
    tally, axis = cell.tally, AXES.get(cell.axis)
    level = axis.value(cell.severity) if axis is not None and 0 < cell.severity <= len(axis.levels) else None
    interval = (tally.interval.low, tally.interval.high) if tally.interval else (None, None)
    return (
        *(cell.simulator, cell.task, cell.policy, cell.policy_digest, cell.axis, cell.severity),
        *(level, axis.unit if axis else None),
        *(tally.planned, tally.done, tally.successes, tally.failures, tally.errors, tally.missing),
        *(tally.rate, *interval, tally.success_once, tally.mean_steps, tally.mean_seconds),
    )
