"""The contents of a report, and its files for programs: `summary.json` and `cells.csv`."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from robogauntlet.results.analysis.behaviour import BehaviourRow
from robogauntlet.results.analysis.combinations import Combinations
from robogauntlet.results.analysis.failures import Failures
from robogauntlet.results.analysis.merging_cost import Merging
from robogauntlet.results.analysis.pairwise import PairwiseComparisons
from robogauntlet.results.analysis.robots import RobotRow, compare_robots
from robogauntlet.results.analysis.robustness import Robustness
from robogauntlet.results.analysis.tables import Aggregate, CellRow, ErrorGroup, NotRun, Tables, Tally
from robogauntlet.results.analysis.timing import AnswerTiming, PhaseTiming
from robogauntlet.results.report.findings import findings
from robogauntlet.results.report.formatting import spreadsheet_cell
from robogauntlet.results.run_document import Provenance, RunDocument, RunStatus
from robogauntlet.results.statistics.rates import CONFIDENCE
from robogauntlet.results.store.episodes_parquet import EPISODES_FILE
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


@dataclass(frozen=True, slots=True)
class ReportPaths:
    """The files of a report, in the run folder."""

    html: Path
    """The page with images and videos inside."""
    markdown: Path
    """The same numbers as text."""
    summary: Path
    """The same numbers for programs: `Summary` as JSON."""
    episodes: Path
    """All rows, Parquet."""
    cells: Path
    """A line per policy, task and condition, CSV."""

    @classmethod
    def in_folder(cls, folder: Path) -> ReportPaths:
        """Return the paths of the report of a run folder."""
        names = ("report.html", "report.md", "summary.json", EPISODES_FILE, "cells.csv")
        return cls(*(folder / name for name in names))


@dataclass(frozen=True)
class Report:
    """The contents of all files of a report."""

    paths: ReportPaths
    document: RunDocument
    tables: Tables
    merging: Merging | None
    """Success lost by merging and routing, if the suite asks for it."""
    robustness: Robustness | None
    """Results under perturbations, if there are any."""
    pairwise: PairwiseComparisons | None = None
    """The policies compared with each other, if there are several."""
    combinations: Combinations | None = None
    """Results under combinations of axes, if there are any."""
    failures: Failures | None = None
    """Kinds of failures, if any is known."""
    behaviour: tuple[BehaviourRow, ...] | None = None
    """How robots move in clean episodes, if it was measured."""

    @cached_property
    def robots(self) -> tuple[RobotRow, ...]:
        """Success by robot in tasks that several play."""
        return compare_robots(self.document.robots, self.tables)

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """Sentences derived from the tests of `robustness`."""
        return findings(self.robustness) if self.robustness else ()


class Summary(BaseModel):
    """The content of `summary.json`. A `format` only gains fields. Rates are shares in [0, 1]."""

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
    merging: Merging | None = None
    """Success lost by merging and routing, if the suite asks for it."""
    robustness: Robustness | None = None
    """Results under perturbations, if there are any. Severities beyond the last level are "Infinity"."""
    pairwise: PairwiseComparisons | None = None
    """The policies compared with each other on clean episodes, if there are several."""
    combinations: Combinations | None = None
    """Which axes matter and where failures gather, if axes were combined. An infinite lift is "Infinity"."""
    failures: Failures | None = None
    """Kinds of failures, if any is known."""
    behaviour: tuple[BehaviourRow, ...] | None = None
    """How robots move in clean episodes, if it was measured."""
    robots: tuple[RobotRow, ...] = ()
    """Success by robot in tasks that several play."""
    findings: tuple[str, ...] = ()
    """Sentences derived from the tests of `robustness`."""


def build_summary(report: Report) -> Summary:
    """Return the summary of a report."""
    document, tables = report.document, report.tables
    return Summary(
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
        merging=report.merging,
        robots=report.robots,
        robustness=report.robustness,
        pairwise=report.pairwise,
        combinations=report.combinations,
        failures=report.failures,
        behaviour=report.behaviour,
        findings=report.findings,
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
